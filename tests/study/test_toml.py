import re
import tomllib
from pathlib import Path

import msgspec
import pytest

from odescope.errors import InputError
from odescope.library.rules import MaximumDegree
from odescope.recordings.coordinate import Coordinate, Input
from odescope.regression.proposers import BackwardElimination, CoefficientThreshold
from odescope.regression.rows import PlainRows
from odescope.signals.cutoff import FixedCutoff
from odescope.signals.differentiators import SavitzkyGolay, Spectral
from odescope.study.options import (
    Candidates,
    Data,
    Driven,
    Filtering,
    Measured,
    Random,
    Regression,
    Study,
)
from odescope.study.toml import moved, parse_study, read_study, study_toml

# A study with nothing left to its default: the format that other programs write.
TEXT = """
[data]
files = ["run1.csv", "run2.csv"]
time = "t"
recording = "segment"

[coordinates.x]
column = "x"
order = 2
cyclic = true
unit = "m"

[coordinates.phi]
column = "phi"
order = 2
angle = true

[inputs.u]
column = "u"
hold = "linear"

[library]
basis = ["x_dot", "phi_dot", "sin(phi)", "cos(phi)", "u"]
degree = 4

[random]
seed = 7
"""
PLAIN = '[data]\nfiles = ["run.csv"]\ntime = "t"\n[coordinates.x]\norder = 2\n[inputs.u]\n'


def refused(text: str) -> str:
    with pytest.raises(InputError) as caught:
        parse_study(text)
    assert "\n" not in str(caught.value)
    return str(caught.value)


# reading


def test_every_part_of_a_study_is_read():
    study = parse_study(TEXT)
    assert study.data == Data(files=("run1.csv", "run2.csv"), time="t", recording="segment")
    assert study.measured() == (Coordinate("x", 2, cyclic=True, unit="m"), Coordinate("phi", 2, angle=True))
    assert study.driven() == (Input("u", "linear"),)
    assert study.library == Candidates(basis=("x_dot", "phi_dot", "sin(phi)", "cos(phi)", "u"), degree=4)
    assert study.random.seed == 7
    layout = study.layout()
    assert layout.columns == (("x", "x"), ("phi", "phi"), ("u", "u"))
    assert (layout.angles, layout.held, layout.units) == (frozenset({"phi"}), frozenset(), (("x", "m"),))


def test_what_a_study_leaves_out_has_its_default():
    study = parse_study("[coordinates.c]\n[inputs.k]\nhold = 'zero'\ncolumn = 'K (mol)'\n")
    assert study.measured() == (Coordinate("c", 1, angle=False, cyclic=False, unit=None),)
    assert (study.library.preset, study.random.seed, study.data.gaps) == ("default", 0, "bridge")
    timed = msgspec.structs.replace(study, data=Data(time="t"))
    assert timed.layout().columns == (("c", "c"), ("k", "K (mol)"))
    assert timed.layout().held == {"k"}


@pytest.mark.parametrize(
    ("old", "new", "parts"),
    [
        ("time =", "tme =", ["unknown key 'tme' in [data]", "did you mean 'time'?"]),
        ("order = 2", "ordr = 2", ["unknown key 'ordr' in [coordinates.x]", "did you mean 'order'?"]),
        ("[inputs.u]", "[inputs.u]\ncolum = 'u'", ["unknown key 'colum' in [inputs.u]", "'column'"]),
        ("[inputs.u]", "[inputs.u]\n[coordinate.y]", ["unknown key 'coordinate' in the study", "'coordinates'"]),
        ("[inputs.u]", "[inputs.u]\n[library]\ndegre = 2", ["unknown key 'degre' in [library]", "'degree'"]),
        ("[inputs.u]", "[inputs.u]\n[random]\nqqq = 2", ["unknown key 'qqq' in [random]", "there are: seed"]),
        (
            "[inputs.u]",
            "[inputs.u]\n[signals.differentiator]\nkind = 'spectral'\ncutof = 1",
            ["unknown key 'cutof' in [signals.differentiator]", "'cutoff'"],
        ),
        (
            "[inputs.u]",
            "[inputs.u]\n[library]\nrules = [{kind = 'identity', off = 'sin(x)'}]",
            ["unknown key 'off' in [library.rules[0]]", "'of'"],
        ),
        ("order = 2", "order = '2'", ["`coordinates.x.order` must be a whole number, not a text"]),
        ("order = 2", "order = 2.5", ["`coordinates.x.order` must be a whole number, not one with decimals"]),
        ("order = 2", "order = 9", ["order must be a whole number from 1 to 8"]),
        ('"t"', "1", ["`data.time` must be a text, not a whole number"]),
        ('["run.csv"]', '"run.csv"', ["`data.files` must be a list, not a text: put it in [brackets]"]),
        ("[inputs.u]", "[inputs.u]\nhold = 'zoh'", ["unknown value 'zoh'", "`inputs.u.hold`", "linear, zero"]),
        ("[inputs.u]", "[inputs.u]\n[library]\npreset = 'papr'", ["unknown value 'papr'", "did you mean 'paper'?"]),
        ("[data]", "[data]\ngaps = 'spilt'", ["unknown value 'spilt'", "did you mean 'split'?"]),
        (
            "[inputs.u]",
            "[inputs.u]\n[signals.differentiator]\nkind = 'spectrl'",
            ["unknown value 'spectrl' at `signals.differentiator.kind`", "'spectral'"],
        ),
        (
            "[inputs.u]",
            "[inputs.u]\n[regression]\nproposers = [{kind = 'stls'}]",
            ["unknown value 'stls' at `regression.proposers[0].kind`", "coefficient_threshold"],
        ),
        (
            "[inputs.u]",
            "[inputs.u]\n[signals.differentiator]\nkind = 'spectral'\n[signals.differentiator.cutoff]\nkind = 'fixed'",
            ["lacks the key `frequency`", "`signals.differentiator.cutoff`"],
        ),
        ("[inputs.u]", "[inputs.u]\n[library]\ndegree = -1", [">= 1", "`library.degree`"]),
        ("[inputs.u]", "[inputs.u]\n[library]\ncoupled = 'atuo'", ["unknown value 'atuo'", "did you mean 'auto'?"]),
        ("[inputs.u]", "[inputs.u]\n[library]\nform = 'lagrange'", ["'lagrange' at `library.form`", "'lagrangian'?"]),
        ("[inputs.u]", "[inputs.u]\n[library]\nform = 'reactions'", ["needs [library] reactions", "composition"]),
        (
            "[inputs.u]",
            "[inputs.u]\n[library]\nform = 'relations'\nkinetic = ['x_dot**2']",
            ['kinetic belongs to form = "lagrangian", but form is "relations"'],
        ),
        (
            "[inputs.u]",
            "[inputs.u]\n[library]\nform = 'lagrangian'\ncomposition = {x = 'a'}",
            ['composition belongs to form = "reactions", but form is "lagrangian"'],
        ),
        (
            "[inputs.u]",
            "[inputs.u]\n[library]\npotential = ['x**2']\nreactions = ['-> x']",
            ["energies and reactions", "different forms"],
        ),
        ("[inputs.u]", "[inputs.u]\n[library]\nkinetc = ['x_dot**2']", ["unknown key 'kinetc'", "'kinetic'"]),
        ("[inputs.u]", "[inputs.u]\n[library]\nkinetic = 'x_dot**2'", ["`library.kinetic` must be a list, not a text"]),
        ("[inputs.u]", "[inputs.u]\n[library]\nforces = ['u']", ["`library.forces` must be a table, not a list"]),
        ("[inputs.u]", "[inputs.u]\n[library]\nmolecules = 5", ["<= 4", "`library.molecules`"]),
        ("[inputs.u]", "[inputs.u]\n[library]\nties = 'a = b'", ["`library.ties` must be a list, not a text"]),
        ("[inputs.u]", "[inputs.u]\n[random]\nseed = -1", [">= 0", "`random.seed`"]),
        ("[inputs.u]", "[inputs.u]\n[signals]\nmargin = nan", ["`signals.margin`"]),
        ("[inputs.u]", "[inputs.u]\n[signals]\nmargin = inf", ["[signals] margin", "got inf"]),
        ("[inputs.u]", "[inputs.u]\n[signals]\nmargin = -0.1", ["`signals.margin`"]),
        ("[inputs.u]", "[inputs.u]\n[regression]\nproposers = []", ["proposers must hold at least one"]),
        ("[inputs.u]", "[inputs.u]\n[library]\nterms = ['x']\nbasis = ['x']", ["terms and basis exclude each other"]),
        (
            "[inputs.u]",
            "[inputs.u]\n[library]\npreset = 'paper'\nrules = [{kind = 'identity', of = 'sin(x)'}]",
            ["rules would do nothing to the paper's preset"],
        ),
        ("coordinates.x", 'coordinates."x y"', ["coordinate 'x y' is not a plain name"]),
        ("coordinates.x", "coordinates.class", ["coordinate 'class' is not a plain name"]),
        ("coordinates.x", "coordinates.t", ["coordinate 't' reads the column 't', which is the time"]),
        ("inputs.u", "inputs.\"__import__('os')\"", ["input \"__import__('os')\" is not a plain name"]),
        ("inputs.u", "inputs.x_dot", ["the name 'x_dot' is used twice"]),
        ("inputs.u", "inputs.tanh", ["'tanh' is the name of a function"]),
        ("[coordinates.x]\norder = 2", "", ["no coordinates", "[coordinates.NAME]"]),
        ("[coordinates.x]\norder = 2", "[coordinates]", ["at least one coordinate", "[coordinates.NAME]"]),
        ("[data]", "[data", ["it is not TOML"]),
        ("[data]", "a = " + "[" * 3000, ["it is not TOML"]),
    ],
)
def test_what_is_wrong_in_a_study_is_named(old, new, parts):
    assert old in PLAIN
    message = refused(PLAIN.replace(old, new))
    for part in parts:
        assert part in message


def test_reading_a_file_names_it(tmp_path):
    path = tmp_path / "my study.toml"
    for content, parts in (
        (None, ["cannot read the study", "No such file"]),
        (b"\xff\xfe[", ["cannot read the study", "decode"]),
        (PLAIN.replace("time", "tme").encode(), ["my study.toml: unknown key 'tme'"]),
        (b'[data]\ntime = "t"\nfiles = ["a\\u0000b.csv"]\n[coordinates.x]\n', ["a data file cannot be called"]),
    ):
        if content is not None:
            path.write_bytes(content)
        with pytest.raises(InputError) as caught:
            read_study(path)
        assert all(part in str(caught.value) for part in parts)


def test_files_beside_a_study_are_named_with_their_whole_paths_and_others_as_they_are(tmp_path, monkeypatch):
    folder = tmp_path / "rig"
    folder.mkdir()
    for name in ("run1.csv", "run2.csv"):
        (folder / name).write_text("t,x\n")
    (folder / "study.toml").write_text(
        PLAIN.replace(PLAIN.split("files = ")[1].split("\n")[0], '["run1.csv", "run?.csv", "away.csv"]')
    )
    monkeypatch.chdir(tmp_path)
    files = read_study("rig/study.toml").data.files
    assert files == (str(folder / "run1.csv"), str(folder / "run?.csv"), "away.csv")


# writing


STUDIES = {
    "plain": parse_study(PLAIN),
    "whole": parse_study(TEXT),
    "everything": Study(
        data=Data(files=("a b.csv", "ü.csv"), sample_period=0.1 + 0.2, gaps="split", jitter=0.01, recording="lap"),
        coordinates={"q": Measured(column='a "quoted" \\ name', angle=True, order=3), "c": Measured(unit="mol/l")},
        inputs={"u": Driven(hold="zero", unit="N")},
        library=Candidates(
            basis=("q_dot", "f(c)"),
            degree=2,
            rules=(MaximumDegree(("q_dot",), 1),),
            functions={"f(v)": "v/(1.0 + v)"},
            coupled=True,
        ),
        signals=Filtering(differentiator=Spectral(FixedCutoff(frequency=1 / 3)), margin=0.0, decimate=False),
        regression=Regression(
            rows=PlainRows(), proposers=(CoefficientThreshold(low=1e-300), BackwardElimination()), nested=False
        ),
        random=Random(seed=2**40),
    ),
    "energies": Study(
        coordinates={"x": Measured(order=2), "phi": Measured(order=2, angle=True)},
        inputs={"u": Driven()},
        library=Candidates(
            form="lagrangian",
            kinetic=("x_dot**2", "phi_dot**2", "x_dot*phi_dot*cos(phi)"),
            potential=("cos(phi)",),
            dissipation=(),
            forces={"x": ("u", "u*cos(phi)"), "phi": ()},
            ties=("x_dot**2 in kinetic = 0.9", "phi_dot**2 = 2*'cos(phi)'"),
        ),
    ),
    "reactions": Study(
        coordinates={"S": Measured(), "C": Measured()},
        library=Candidates(
            form="reactions", composition={"S": "s", "C": "2 s"}, reactions=("2 S <-> C", "-> S"), molecules=4
        ),
    ),
    "filter": Study(
        coordinates={"x": Measured()}, signals=Filtering(differentiator=SavitzkyGolay(window=31)), data=Data(time="t")
    ),
}


@pytest.mark.parametrize("name", STUDIES)
def test_a_study_reads_back_as_it_was_written(name):
    study = STUDIES[name]
    assert parse_study(study_toml(study)) == study
    assert study_toml(parse_study(study_toml(study))) == study_toml(study)


@pytest.mark.parametrize("name", STUDIES)
def test_the_written_study_leaves_no_default_unsaid(name):
    def unsaid(struct: object, table: dict[str, object], at: str) -> list[str]:
        missing = []
        for field in msgspec.structs.fields(type(struct)):
            value = getattr(struct, field.name)
            if value is None:
                continue
            if field.name not in table:
                missing.append(f"{at}.{field.name}")
            elif isinstance(value, msgspec.Struct):
                missing += unsaid(value, table[field.name], f"{at}.{field.name}")
            elif isinstance(value, dict):
                for key, inner in value.items():
                    if isinstance(inner, msgspec.Struct):
                        missing += unsaid(inner, table[field.name][key], f"{at}.{field.name}.{key}")
        return missing

    written = tomllib.loads(study_toml(STUDIES[name]))
    assert unsaid(STUDIES[name], written, "") == []
    assert written["signals"]["differentiator"]["kind"] in ("spectral", "savitzky_golay")


def test_moved_files_are_the_same_files(tmp_path, monkeypatch):
    old, new = tmp_path / "a b" / "c", tmp_path / "d"
    for folder in (old, new):
        folder.mkdir(parents=True)
    (tmp_path / "a b" / "run.csv").write_text("t,x\n")
    study = Study(coordinates={"x": Measured()}, data=Data(files=("../run.csv", str(tmp_path / "far.csv")), time="t"))
    monkeypatch.chdir(tmp_path)
    for start, end in ((old, new), (Path("a b/c"), Path("d"))):
        there = moved(study, start, end)
        assert there.data.files == ("../a b/run.csv", "../far.csv")
        assert (new / there.data.files[0]).resolve() == (tmp_path / "a b" / "run.csv").resolve()
        assert re.sub("files.*", "", repr(there)) == re.sub("files.*", "", repr(study))


def test_the_choices_that_are_told_are_those_of_toml():
    with pytest.raises(
        InputError, match=r"unknown value 'year' at `data.time_unit`; there are: s, ms, us, ns, min, h, d$"
    ):
        parse_study('[data]\ntime_unit = "year"\n[coordinates.x]\n')


def test_a_study_may_have_a_byte_order_mark(tmp_path):
    (tmp_path / "study.toml").write_text(TEXT, encoding="utf-8-sig")
    assert read_study(tmp_path / "study.toml") == parse_study(TEXT)


def test_a_number_in_quotes_is_told_what_is_wanted():
    told = refused('[coordinates.x]\n[inputs.u]\ndelay = "0.02"\n')
    assert told == "unknown value '0.02' at `inputs.u.delay`; there are: a number without quotes, auto, estimate"
    with pytest.raises(InputError, match='delay must be a number of seconds, "auto" or "estimate", got'):
        Driven(delay="0.02")


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ("[library.parameters]\nv0 = [1.0, 0.1]\n", r"^\[library.parameters\] v0 wants a range .*\[1.0, 0.1\] came$"),
        ('[inputs.v]\ncolumn = ["a", "a"]\n', r"^\[inputs.v\] column must be a name, or several different ones"),
        ('[library]\nterms = ["x"]\nbasis = ["x"]\n', r"^\[library\] terms and basis exclude each other"),
    ],
)
def test_what_a_table_says_of_itself_is_told_with_its_name_and_nothing_of_the_parser(table, said):
    assert re.search(said, refused(PLAIN + table))
