import csv
import os
import stat
from pathlib import Path

import numpy as np
import pytest
from logs import oscillator

from odescope.commands.files import (
    CANDIDATE_COLUMNS,
    WRITTEN,
    candidates_csv,
    check_writable,
    refuse_foreign,
    refuse_overwriting,
    result_files,
    write_results,
)
from odescope.errors import InputError
from odescope.export.model_file import from_json
from odescope.files import write_file, write_files
from odescope.pipeline.identification import identify
from odescope.report.result_names import RESULT_FILES
from odescope.study.library_options import Candidates
from odescope.study.options import Data, Driven, Measured, Study
from odescope.study.toml import parse_study

STUDY = Study(
    data=Data(time="t"),
    coordinates={"x": Measured(order=2)},
    inputs={"u": Driven()},
    library=Candidates(terms=("1", "x", "x_dot", "u", "x**2", "u*x", "x_ddot", "x*x_ddot")),
)
FILES = {"a.txt": "one\n", "b.txt": "two\r\nü", "figures/c.png": b"\x89PNG\r\n\x1a\n", "figures/c.svg": "<svg/>"}


@pytest.fixture(scope="module")
def result():
    return identify(STUDY, oscillator())


# candidates.csv


def test_candidates_are_ranked_and_one_a_target_is_chosen(result):
    rows = list(csv.DictReader(candidates_csv(result).splitlines()))
    assert tuple(rows[0]) == CANDIDATE_COLUMNS
    contract = "target,guess,support,number_of_terms,consensus,implicit_rmse,acceleration_rmse,rank,chosen"
    assert candidates_csv(result).startswith(contract)
    assert len(rows) == len(result.searches[0].ranked.candidates) > 3
    assert [int(r["rank"]) for r in rows] == list(range(1, len(rows) + 1))
    (chosen,) = [r for r in rows if r["chosen"] == "1"]
    assert set(chosen["support"].split(" + ")) == {"x", "x_dot", "u", "x_ddot"}
    assert {r["chosen"] for r in rows} == {"0", "1"}


def evaluated(text, column):
    return eval(text, {"__builtins__": {}}, dict(column)) * np.ones(len(column["x"]))  # noqa: S307 (our own output)


def test_what_a_row_says_is_true_of_its_relation(result):
    (search,) = result.searches
    terms = [t.expanded.text for t in search.problem.terms]
    signals = result.signals.joined()
    column = {name: signals[result.signals.row(name)] for name in result.signals.names}
    for row, candidate in zip(
        csv.DictReader(candidates_csv(result).splitlines()), search.ranked.candidates, strict=True
    ):
        support = row["support"].split(" + ")
        assert len(support) == int(row["number_of_terms"]) == len(set(support))
        assert row["guess"] in support
        assert 1 <= int(row["consensus"]) <= len(support)
        values = np.array([evaluated(text, column) for text in support])
        xi = np.array([candidate.xi[terms.index(text)] for text in support])
        own = [k for k, text in enumerate(support) if "x_ddot" in text]
        size = np.abs(values[own]).max()
        assert np.sqrt(np.mean((xi @ values) ** 2)) < 3 * float(row["acceleration_rmse"]) + 1e-9 * size


def test_the_files_read_back(result):
    report = {"report.html": "<html></html>", "report.json": "{}", "figures/one.png": b"\x89"}
    files = result_files(result, STUDY, report)
    on_path = result.model.scores.path
    assert on_path
    assert set(files) == {
        *RESULT_FILES,
        "figures/one.png",
        "path.csv",
        *(f"path/{s.terms}_terms.json" for s in on_path),
    }
    rows = list(csv.DictReader(files["path.csv"].splitlines()))
    assert [int(r["chosen"]) for r in rows] == [s.chosen for s in on_path]
    for row, model in zip(rows, result.path, strict=True):
        stored = from_json(files[f"path/{row['terms']}_terms.json"])
        assert stored.relations == model.relations
        assert sum(len(r.terms) for r in stored.relations) == int(row["terms"]) == len(row["support"].split(" + "))
    assert parse_study(files["study.toml"]) == STUDY
    assert from_json(files["model.json"]).relations == result.model.relations
    assert files["candidates.csv"] == candidates_csv(result)
    assert report.items() <= files.items()


# writing


def test_files_are_written_as_they_are_and_nothing_else_is_left(tmp_path):
    for folder in (tmp_path / "new" / "deep", tmp_path):
        write_files(folder, FILES)
        for name, content in FILES.items():
            assert (folder / name).read_bytes() == (content if isinstance(content, bytes) else content.encode())
    assert sorted(os.listdir(tmp_path)) == ["a.txt", "b.txt", "figures", "new"]
    assert sorted(os.listdir(tmp_path / "figures")) == ["c.png", "c.svg"]
    assert sorted(os.listdir(tmp_path / "new")) == ["deep"]


def test_models_of_a_longer_path_go_and_nothing_else_does(tmp_path):
    older = dict.fromkeys(("path/2_terms.json", "path/9_terms.json", "path/notes.txt", "9_terms.json"), "old")
    write_files(tmp_path, older)
    newer = {"path/2_terms.json": "new", "model.json": "new"}
    write_results(tmp_path, newer)
    found = {str(p.relative_to(tmp_path)): p.read_text() for p in tmp_path.rglob("*") if p.is_file()}
    assert found == {"path/notes.txt": "old", "9_terms.json": "old", **newer}


def test_a_path_of_an_earlier_run_goes_where_a_later_one_has_none(tmp_path):
    write_results(tmp_path, dict.fromkeys(("model.json", "path.csv", "path/2_terms.json"), "old"))
    write_results(tmp_path, {"model.json": "new"})
    assert os.listdir(tmp_path) == ["model.json"]


def test_results_have_the_permissions_that_the_user_set(tmp_path):
    before = os.umask(0o027)
    try:
        write_files(tmp_path / "results", FILES)
        write_file(tmp_path / "c.csv", "c")
    finally:
        os.umask(before)
    modes = {p.name: stat.S_IMODE(p.stat().st_mode) for p in tmp_path.rglob("*")}
    files = dict.fromkeys(("a.txt", "b.txt", "c.csv", "c.png", "c.svg"), 0o640)
    assert modes == {"results": 0o750, "figures": 0o750, **files}


@pytest.mark.parametrize("there", [True, False])
def test_a_write_that_fails_changes_nothing(tmp_path, monkeypatch, there):
    folder = tmp_path / "results"
    if there:
        write_files(folder, {"a.txt": "old", "b.txt": "old"})
    before = {p: p.read_text() for p in tmp_path.rglob("*.txt")}
    original = Path.write_text

    def full(path, text, **options):
        original(path, text[:1], **options)
        if path.name == "b.txt":
            raise OSError(28, "No space left on device")
        return original(path, text, **options)

    monkeypatch.setattr(Path, "write_text", full)
    with pytest.raises(InputError, match=r"cannot write to .*results: No space left on device"):
        write_files(folder, FILES)
    assert {p: p.read_text() for p in tmp_path.rglob("*") if p.is_file()} == before
    assert folder.exists() == there


def test_a_single_file_that_fails_leaves_the_old_one(tmp_path, monkeypatch):
    write_file(tmp_path / "deep" / "c.csv", "old")

    def refuse(*_):
        raise OSError(13, "Permission denied")

    monkeypatch.setattr(os, "replace", refuse)
    with pytest.raises(InputError, match="Permission denied"):
        write_file(tmp_path / "deep" / "c.csv", "new")
    assert os.listdir(tmp_path / "deep") == ["c.csv"]
    assert (tmp_path / "deep" / "c.csv").read_text() == "old"


def test_a_device_is_written_and_not_replaced(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    reader = os.open(tmp_path / "pipe", os.O_RDONLY | os.O_NONBLOCK)
    try:
        write_file(tmp_path / "pipe", "through")
        assert os.read(reader, 100) == b"through"
    finally:
        os.close(reader)
    assert stat.S_ISFIFO((tmp_path / "pipe").stat().st_mode)


def test_what_cannot_be_a_results_folder(tmp_path):
    (tmp_path / "file").write_text("")
    (tmp_path / "odd" / "candidates.csv").mkdir(parents=True)
    (tmp_path / "flat").mkdir()
    (tmp_path / "flat" / "figures").write_text("")
    for folder, part in (
        ("flat", "figures is no folder"),
        ("file", "is not a folder"),
        ("file/sub", "is not a folder"),
        ("odd", "candidates.csv is a folder"),
    ):
        with pytest.raises(InputError, match=part):
            check_writable(tmp_path / folder)
    check_writable(tmp_path / "not" / "there" / "yet")
    assert sorted(os.listdir(tmp_path)) == ["file", "flat", "odd"]


def test_overwriting_is_seen_through_links_and_detours(tmp_path):
    source = tmp_path / "run.csv"
    source.write_text("")
    (tmp_path / "link.csv").symlink_to(source)
    (tmp_path / "sub").mkdir()
    refuse_overwriting([tmp_path / "other.csv", tmp_path / "sub" / "run.csv"], [source])
    for target in (source, tmp_path / "link.csv", tmp_path / "sub" / ".." / "run.csv"):
        with pytest.raises(InputError, match="would overwrite"):
            refuse_overwriting([tmp_path / "other.csv", target], [source])


@pytest.mark.parametrize("name", ["study.toml", "path.csv", "no_model.html", "figures/plot.png", "path/7_terms.json"])
def test_a_file_of_ones_own_that_is_called_like_a_result_stays(tmp_path, name):
    own = tmp_path / name
    own.parent.mkdir(exist_ok=True)
    own.write_text("my own")
    with pytest.raises(InputError, match=rf"holds {name} and no results of odescope.*--out"):
        refuse_foreign(tmp_path, WRITTEN)
    assert own.read_text() == "my own"
    (tmp_path / "model.json").write_text('{"format": "my own/model"}')
    with pytest.raises(InputError, match=r"holds .*model\.json"):
        refuse_foreign(tmp_path, WRITTEN)


def test_results_stand_beside_what_a_project_holds_and_replace_earlier_ones(result, tmp_path):
    for name in ("notes.txt", "log.csv", "figures/plot.pdf", "path/way_terms.json"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("my own")
    for _ in range(2):
        refuse_foreign(tmp_path, WRITTEN)
        write_results(tmp_path, result_files(result, STUDY, {"report.html": "drawn", "figures/a.svg": "<svg/>"}))
        (tmp_path / "path" / "99_terms.json").write_text("of an earlier result")
    write_results(tmp_path, result_files(result, STUDY, {}))
    for name in ("notes.txt", "log.csv", "figures/plot.pdf", "path/way_terms.json"):
        assert (tmp_path / name).read_text() == "my own"
    assert not (tmp_path / "path" / "99_terms.json").exists()
