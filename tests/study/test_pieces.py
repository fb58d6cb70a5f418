"""Pieces of one's own in study files: what installed packages offer by name, and objects that no file can name."""

import tomllib
from dataclasses import dataclass
from pathlib import Path

import pytest
from logs import oscillator
from msgspec import structs

from odescope.errors import InputError
from odescope.pipeline.filtering import kept_in
from odescope.pipeline.identification import identify
from odescope.regression.proposers import BackwardElimination
from odescope.regression.rows import NoiseWeighted
from odescope.report.assemble import summary
from odescope.study.library_options import Candidates
from odescope.study.options import Data, Driven, Filtering, Measured, Regression, Study
from odescope.study.toml import parse_study, study_toml

PACKAGE = """
from dataclasses import dataclass
from itertools import combinations

import msgspec

from odescope.regression.rows import NoiseWeighted
from odescope.signals.differentiators import Spectral


@dataclass(frozen=True)
class Subsets:
    terms: int = 3
    least: int | None = None

    def supports(self, factor, left, columns):
        others = [j for j in columns if j != left]
        for size in range(self.least or 1, self.terms + 1):
            yield from combinations(others, size)


class Halved(msgspec.Struct, frozen=True, tag="halved", tag_field="kind", forbid_unknown_fields=True):
    share: float = 1.0

    def derivatives(self, channel, period, order):
        return Spectral().derivatives(channel, period, order)


class Weighted:
    def row_map(self, signals, order, blocks, values, left):
        return NoiseWeighted().row_map(signals, order, blocks, values, left)


def no_class(): ...
"""
OFFERED = """
[odescope.proposers]
subsets = vibrations.pieces:Subsets
gone = vibrations.pieces:Gone
broken = vibrations.broken:Subsets
no_class = vibrations.pieces:no_class
not_one = vibrations.pieces:Weighted
energy_threshold = vibrations.pieces:no_class

[odescope.differentiators]
halved = vibrations.pieces:Halved

[odescope.rows]
weighted = vibrations.pieces:Weighted
"""
LIBRARY = Candidates(terms=("1", "x", "x_dot", "u", "x_ddot"))
BARE = Study(data=Data(time="t"), coordinates={"x": Measured(order=2)}, inputs={"u": Driven()}, library=LIBRARY)


@pytest.fixture(scope="module")
def package(tmp_path_factory):
    """Install a package of pieces, as far as Python can tell."""
    root = tmp_path_factory.mktemp("site")
    (root / "vibrations").mkdir()
    (root / "vibrations/__init__.py").touch()
    (root / "vibrations/pieces.py").write_text(PACKAGE)
    (root / "vibrations/broken.py").write_text("raise RuntimeError('no licence')")
    about = root / "vibrations-2.5.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: vibrations\nVersion: 2.5\n")
    (about / "entry_points.txt").write_text(OFFERED)
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(root)
        from vibrations import pieces

        yield pieces


def toml(*proposers, tail=""):
    named = "".join(f"[[regression.proposers]]\n{p}\n" for p in proposers)
    return f"[data]\ntime = 't'\n[coordinates.x]\norder = 2\n{named}{tail}"


def test_a_study_names_what_packages_offer_and_is_written_back(package):
    tail = "[regression.rows]\nkind = 'weighted'\n[signals.differentiator]\nkind = 'halved'\nshare = 0.5\n"
    text = toml("kind = 'subsets'\nterms = 2", "kind = 'backward_elimination'\nterms = 4", tail=tail)
    text = text.replace("[regression.rows]", "[signals]\nmargin = 0.25\n[regression.rows]")
    study = parse_study(text)
    assert study.regression.proposers == (package.Subsets(terms=2), BackwardElimination(terms=4))
    assert study.signals == Filtering(differentiator=package.Halved(0.5), margin=0.25)
    assert type(study.regression.rows) is package.Weighted
    written = study_toml(study)
    assert "#" not in written
    tables = tomllib.loads(written)
    assert tables["regression"]["proposers"][0] == {"kind": "subsets", "terms": 2}  # what is None is left out
    assert tables["regression"]["rows"] == {"kind": "weighted"}
    assert tables["signals"]["differentiator"] == {"kind": "halved", "share": 0.5}
    again = parse_study(written)
    assert again.regression.proposers == study.regression.proposers
    assert again.signals == study.signals
    assert study_toml(again) == written


@pytest.mark.parametrize(
    ("table", "parts"),
    [
        ("kind = 'subset'", ["unknown value 'subset'", "did you mean 'subsets'?"]),
        ("kind = 'subsets'\ntrems = 2", ["unknown key 'trems' in [regression.proposers[1]]", "did you mean 'terms'?"]),
        ("kind = 'subsets'\nterms = 'two'", ["`regression.proposers[1].terms` must be a whole number, not a text"]),
        ("kind = 'gone'", ["'gone'", "vibrations", "cannot be loaded"]),
        ("kind = 'broken'", ["vibrations", "cannot be loaded (no licence)"]),
        ("kind = 'no_class'", ["no class with a method supports"]),
        ("kind = 'not_one'", ["no class with a method supports"]),
        ("kind = 'weighted'", ["unknown value 'weighted'"]),  # a piece of another place
        ("kind = 7", ["regression.proposers[1]"]),
        ("kind = 'vibrations.pieces:Subsets'", ["unknown value"]),  # a name is no import
    ],
)
def test_what_is_wrong_with_a_named_piece_is_said(package, table, parts):
    with pytest.raises(InputError) as caught:
        parse_study(toml("kind = 'subsets'", table))
    for part in parts:
        assert part in str(caught.value)


def test_a_package_does_not_take_the_place_of_what_is_there(package):
    assert type(parse_study(toml("kind = 'energy_threshold'")).regression.proposers[0]).__module__.startswith(
        "odescope"
    )


def test_a_broken_piece_of_the_same_package_does_no_harm_to_writing(package):
    study = Study(coordinates={"x": Measured()}, regression=Regression(proposers=(package.Subsets(),)))
    assert tomllib.loads(study_toml(study))["regression"]["proposers"] == [{"kind": "subsets", "terms": 3}]


@dataclass(frozen=True)
class Small:
    """An object of a script: a proposer, a differentiator and a choice of rows at once."""

    size: int = 3

    def supports(self, factor, left, columns):
        from itertools import combinations

        others = [j for j in columns if j != left]
        for size in range(1, self.size + 1):
            yield from combinations(others, size)

    def derivatives(self, channel, period, order):
        from odescope.signals.differentiators import Spectral

        return Spectral().derivatives(channel, period, order)

    def row_map(self, signals, order, blocks, values, left):
        return NoiseWeighted().row_map(signals, order, blocks, values, left)


SCRIPTED = {
    "proposers": structs.replace(BARE, regression=Regression(proposers=(Small(),))),
    "rows": structs.replace(BARE, regression=Regression(rows=Small())),
    "differentiator": structs.replace(BARE, signals=Filtering(differentiator=Small(), margin=0.7)),
}


@pytest.mark.parametrize("place", SCRIPTED)
def test_an_object_of_a_script_goes_through_report_store_and_study_file(place, tmp_path):
    study = SCRIPTED[place]
    result = identify(study, oscillator())
    assert {t.text for t in result.model.relations[0].terms} == {"x", "x_dot", "u", "x_ddot"}
    (note,) = [n for n in result.notes if "cannot name" in n]
    assert f"Small of {__name__}" in note
    text = summary(result).reproduce.study
    first = text.splitlines()[0]
    assert first.startswith("# ")
    assert place in first
    assert f"Small of {__name__}" in first
    back = parse_study(text)
    assert back.regression == Regression()
    assert back.signals == Filtering(margin=study.signals.margin)
    assert back.library == study.library
    # Proposers do not touch what is kept.
    assert (kept_in(tmp_path, study) == kept_in(tmp_path, BARE)) == (place == "proposers")


def test_of_several_proposers_those_with_a_name_are_written(package):
    own = Regression(proposers=(Small(), BackwardElimination(terms=3), package.Subsets(terms=2)))
    text = study_toml(Study(coordinates={"x": Measured()}, regression=own))
    assert text.startswith("# regression.proposers[0] was Small of ")
    assert parse_study(text).regression.proposers == own.proposers[1:]


def test_what_toml_cannot_hold_is_a_comment(package):
    class Told:
        def supports(self, factor, left, columns):
            return iter(())

        def __repr__(self):
            return "two\nlines = 'and code'"

    Told.__qualname__ = "Told\n[data]\ntime"
    for piece in (Told(), package.Subsets(terms=Path("no number"))):
        text = study_toml(Study(coordinates={"x": Measured()}, regression=Regression(proposers=(piece,))))
        assert parse_study(text) == Study(coordinates={"x": Measured()})
        assert text.startswith("# regression.proposers[0] was ")


def test_what_is_kept_goes_by_the_version_of_the_package(package, tmp_path):
    def named(share):
        return Study(coordinates={"x": Measured()}, signals=Filtering(differentiator=package.Halved(share)))

    one = kept_in(tmp_path, named(0.5))
    assert one == kept_in(tmp_path, named(0.5))
    assert one != kept_in(tmp_path, named(0.6))
    about = Path(package.__file__).parents[1] / "vibrations-2.5.dist-info" / "METADATA"
    old = about.read_text()
    about.write_text(old.replace("2.5", "2.6"))
    try:
        assert one != kept_in(tmp_path, named(0.5))
    finally:
        about.write_text(old)
