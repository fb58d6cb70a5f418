"""Options of wrong kinds, from Python: told as those of a study file are."""

from pathlib import Path

import numpy as np
import pytest

from odescope.errors import InputError
from odescope.pipeline.identification import identify
from odescope.study.library_options import Candidates
from odescope.study.options import Data, Driven, Measured, Random, Study


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Data(time=3), r"odescope.Data\(time=...\): expected str, got int; 3 came"),
        (lambda: Data(sample_period="fast"), r"Data\(sample_period=...\): expected float, got str; 'fast' came"),
        (lambda: Data(files=[3]), r"Data\(files=...\): expected str, got int at \[0\]"),
        (lambda: Measured(order="2"), r"Measured\(order=...\): expected int, got str; '2' came"),
        (lambda: Measured(cyclic=1), r"Measured\(cyclic=...\): expected bool, got int; 1 came"),
        (lambda: Driven(unit=1), r"Driven\(unit=...\): expected str, got int; 1 came"),
        (lambda: Random(seed="one"), r"Random\(seed=...\): expected int, got str; 'one' came"),
        (lambda: Candidates(basis="x"), r"Candidates\(basis=...\): expected .*, got str; 'x' came"),
        (lambda: Candidates(degree="3"), r"Candidates\(degree=...\): expected int, got str"),
    ],
)
def test_a_field_of_another_kind_is_refused_with_its_name(make, message):
    with pytest.raises(InputError, match=message):
        make()


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"coordinates": ["x"]}, r'coordinates must be {"NAME": odescope.Measured\(...\)}; a list came'),
        ({"coordinates": {"x": {"order": 2}}}, r"odescope.Measured\(...\)}; of 'x' came a dict"),
        ({"coordinates": {"x": Measured()}, "inputs": {"u": "zero"}}, r"odescope.Driven\(...\)}; of 'u' came a str"),
        ({"coordinates": {}}, "a study needs at least one coordinate"),
    ],
)
def test_coordinates_and_inputs_are_options_by_name(fields, message):
    with pytest.raises(InputError, match=message):
        identify(Study(**fields, data=Data(time="t")), {"t": [0.0], "x": [1.0]})


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        (
            {"data": {"time": "t", "gaps": "split"}},
            r"data must be odescope.Data\(...\); a dict came: write data=odescope.Data\(time='t', gaps='split'\)",
        ),
        ({"data": "t"}, r"data must be odescope.Data\(...\); a str came: write data=odescope.Data\(...\)"),
        ({"library": {"degre": 2}}, r"library must be .*; a dict came: write library=odescope.Candidates\(...\)"),
        ({"signals": {"margin": 0.5}}, r"write signals=odescope.Filtering\(margin=0.5\)"),
        ({"regression": []}, r"a list came: write regression=odescope.Regression\(...\)"),
        ({"selection": None}, r"None came: write selection=odescope.Ranking\(...\)"),
        ({"likelihood": {"seconds": 5}}, r"write likelihood=odescope.LikelihoodSearch\(seconds=5\)"),
        ({"random": 3}, r"an int came: write random=odescope.Random\(...\)"),
    ],
)
def test_a_table_of_another_kind_is_refused_with_what_to_write(fields, message):
    with pytest.raises(InputError, match=message):
        Study(coordinates={"x": Measured()}, **fields)


def test_what_python_has_beside_the_kinds_of_a_file_is_taken():
    assert Data(files="run.csv") == Data(files=("run.csv",))
    assert Data(files=[Path("a.csv"), "b.csv"]).files == ("a.csv", "b.csv")
    assert Data(sample_period=np.float64(0.5), memory=500) == Data(sample_period=0.5, memory=500.0)
    assert Candidates(basis=["x", "u"]).basis == ("x", "u")
    assert Driven(delay=0).delay == 0.0
    assert Measured(order=np.int64(2)) == Measured(order=2)
    assert Candidates(parameters={"v": (np.float64(0.1), np.float64(2.0))}).parameters == {"v": (0.1, 2.0)}
    assert type(Random(seed=np.int64(2)).seed) is int
