"""Which logs go together, and what their study is called."""

import pytest

pytest.importorskip("nicegui")

from workbench_cases import decay

from odescope.workbench.folder import Folder
from odescope.workbench.log_study import alike, in_order, study_of


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "more").mkdir()
    for name in ("run1.csv", "run2.csv", "run10.csv", "more/run3.csv"):
        decay(tmp_path / name)
    decay(tmp_path / "other.csv", "d")
    (tmp_path / "broken.csv").write_bytes(b"\0\1")
    return Folder.of(tmp_path)


def study(folder, name, *files):
    text = f'[data]\nfiles = {list(files)}\ntime = "t"\n[coordinates.c]\n'
    (folder.root / name).write_text(text)


def test_logs_with_the_same_columns_are_alike_those_beside_first(folder):
    assert set(alike(folder, "run2.csv")[:2]) == {"run1.csv", "run10.csv"}
    assert alike(folder, "run2.csv")[2:] == ("more/run3.csv",)
    assert alike(folder, "other.csv") == ()
    decay(folder.root / "run1.csv", "another")  # changed since it was looked at
    assert "run1.csv" not in alike(folder, "run2.csv")


def test_recordings_are_counted_as_people_count():
    names = ["b/a.csv", "run10.csv", "run9.csv", "2.csv", "run.csv"]
    assert in_order(names) == ["2.csv", "run9.csv", "run10.csv", "run.csv", "b/a.csv"]


def test_a_study_of_several_logs_takes_no_place_of_another(folder):
    names, root = ["run1.csv", "run2.csv"], folder.root
    assert study_of(folder, names) == (root / "run1-and-1-more.toml", False)
    study(folder, "run1-and-1-more.toml", "run1.csv", "run10.csv")
    assert study_of(folder, names) == (root / "run1-and-1-more-2.toml", False)
    (root / "run1-and-1-more-2").mkdir()  # results whose study is gone
    assert study_of(folder, names) == (root / "run1-and-1-more-3.toml", False)
    (root / "run1-and-1-more-3.toml").write_text("no [ TOML")
    assert study_of(folder, names) == (root / "run1-and-1-more-4.toml", False)
    study(folder, "run1-and-1-more-4.toml", "more/../run2.csv", "run1.csv")
    assert study_of(folder, names) == (root / "run1-and-1-more-4.toml", True)


def test_of_one_log_the_study_of_its_name_is_found_unless_it_is_of_others(folder):
    path = folder.root / "run1.toml"
    (folder.root / "run1").mkdir()  # as the command line has it, that needs no study
    assert study_of(folder, ["run1.csv"]) == (path, False)
    path.write_text("no [ TOML")
    assert study_of(folder, ["run1.csv"]) == (path, True)
    study(folder, "run1.toml", "run*.csv")
    assert study_of(folder, ["run1.csv"]) == (path, True)
    study(folder, "run1.toml", "run2.csv")
    assert study_of(folder, ["run1.csv"]) == (folder.root / "run1-2.toml", False)
