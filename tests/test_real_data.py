"""Real recordings, where they are at hand: the dominant coefficients of docs/real-data.md."""

from __future__ import annotations

import os
from pathlib import Path

import msgspec
import pytest

from odescope.pipeline.identification import identify
from odescope.study.toml import read_study

ROOT = Path(__file__).parent.parent
DATA = Path(os.environ.get("ODESCOPE_DATA", ROOT.parent / "shared" / "data"))

ACCEPTED = {
    "actuated_pendulum": [{"torque": -4.67, "sin(q)": 20.7}],
    "single_pendulum": [{"sin(theta)": -64.2}],
    "double_pendulum": [
        {"sin(phi1)": -58.96, "phi2_ddot*cos(phi1 - phi2)": 0.4913, "phi2_dot**2*sin(phi1 - phi2)": 0.4913},
        {"sin(phi2)": -50.11, "phi1_ddot*cos(phi1 - phi2)": 0.8824, "phi1_dot**2*sin(phi1 - phi2)": -0.8824},
    ],
}


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=pytest.mark.slow) if n != "actuated_pendulum" else n for n in ACCEPTED]
)
def test_dominant_coefficients(name: str) -> None:
    if not DATA.is_dir():
        pytest.skip("set ODESCOPE_DATA to the folder of the recordings")
    study = read_study(ROOT / "docs" / "studies" / f"{name}.toml")
    files = tuple(str(DATA / name / f) for f in study.data.files)
    result = identify(msgspec.structs.replace(study, data=msgspec.structs.replace(study.data, files=files)))
    for relation, accepted in zip(result.model.relations, ACCEPTED[name], strict=True):
        found = {t.text: t.coefficient for t in relation.terms}
        for term, value in accepted.items():
            assert found[term] == pytest.approx(value, rel=0.05)
