"""Paths stay in the folder of a workbench, and what lies in it is found."""

import os

import pytest

pytest.importorskip("nicegui")

from odescope.errors import InputError
from odescope.study.toml import parse_study
from odescope.workbench.folder import Folder

STUDY = "[coordinates.x]\n"


@pytest.fixture
def place(tmp_path):
    inside = tmp_path / "inside"
    inside.mkdir()
    (tmp_path / "secret.csv").write_text("t,x\n0,1\n")
    (tmp_path / "inside-too").mkdir()
    return inside


@pytest.mark.parametrize(
    "text",
    [
        "", "..", "../secret.csv", "a/../../secret.csv", "/etc/passwd", "a/..", "\0", "a\0b", "..\\secret.csv",
        "C:\\secret.csv", "C:secret.csv", "\\\\host\\share", "//host/share", "../inside-too",
    ],
)  # fmt: skip
def test_texts_that_leave_the_folder_are_refused(place, text):
    with pytest.raises(InputError, match="is no path within"):
        Folder.of(place).inside(text)


def test_paths_inside_are_those_that_are_named(place):
    folder = Folder.of(place)
    for name in ("a.csv", "b/c.csv", "...", "a..b", "~", "b/./c.csv", "%2e%2e"):
        assert folder.inside(name) == place.resolve() / name


def test_links_are_followed_before_they_are_judged(place):
    folder = Folder.of(place)
    (place / "file.csv").symlink_to(place.parent / "secret.csv")
    (place / "up").symlink_to(place.parent)
    (place / "circle").symlink_to(place / "circle")
    (place / "real.csv").write_text("t,x\n0,1\n")
    (place / "own.csv").symlink_to(place / "real.csv")
    for name in ("file.csv", "up/secret.csv", "up", "up/new.toml"):
        with pytest.raises(InputError, match="lies outside"):
            folder.inside(name)
    assert folder.inside("own.csv").read_text() == "t,x\n0,1\n"
    assert folder.logs() == ("own.csv", "real.csv")


def test_what_a_study_reads_lies_inside(place):
    folder = Folder.of(place)
    (place / "a.csv").write_text("t,x\n0,1\n")

    def files(named):
        return folder.files_of(parse_study(f"[data]\nfiles = [{named!r}]\n{STUDY}"), place)

    assert files("a.csv") == (place / "a.csv",)
    for named in ("../secret.csv", str(place.parent / "secret.csv"), "../*.csv"):
        with pytest.raises(InputError, match="lies outside"):
            files(named)


def test_logs_studies_and_results_are_told_apart(place):
    folder = Folder.of(place)
    for name in (
        "b.csv",
        "deep/a.parquet",
        "run/candidates.csv",
        "run/model.json",
        "run/study.toml",
        "none/no_model.html",
    ):
        (place / name).parent.mkdir(exist_ok=True)
        (place / name).write_text("x")
    (place / "b.toml").write_text(STUDY)
    (place / "other.toml").write_text("[project]\n")
    (place / "broken.toml").write_text("[coordinates")
    (place / ".hidden").mkdir()
    (place / ".hidden" / "c.csv").write_text("x")
    os.utime(place / "run/model.json", (1, 1))
    assert folder.logs() == ("b.csv", "deep/a.parquet")
    assert folder.studies() == ("b.toml",)
    assert folder.results() == ("none", "run")


def test_a_file_is_no_folder(place):
    with pytest.raises(InputError, match="is no folder"):
        Folder.of(place.parent / "secret.csv")
