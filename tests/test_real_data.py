"""Real recordings, where they are at hand: the dominant coefficients of docs/real-data.md, and how few terms tell."""

from __future__ import annotations

import os
from pathlib import Path

import msgspec
import pytest

from odescope.pipeline.identification import identify
from odescope.recordings.readers import read_records
from odescope.recordings.record import Records
from odescope.study.library_options import Candidates
from odescope.study.options import Study
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


needs_data = pytest.mark.skipif(not DATA.is_dir(), reason="set ODESCOPE_DATA to the folder of the recordings")


def recorded(name: str) -> Study:
    """Return the study of docs/studies under this name, with its recordings."""
    study = read_study(ROOT / "docs" / "studies" / f"{name}.toml")
    files = tuple(str(DATA / name / f) for f in study.data.files)
    return msgspec.structs.replace(study, data=msgspec.structs.replace(study.data, files=files))


@needs_data
@pytest.mark.slow
@pytest.mark.parametrize("name", ACCEPTED)
def test_dominant_coefficients(name: str) -> None:
    result = identify(recorded(name))
    for relation, accepted in zip(result.model.relations, ACCEPTED[name], strict=True):
        found = {t.text: t.coefficient for t in relation.terms}
        for term, value in accepted.items():
            assert found[term] == pytest.approx(value, rel=0.05)


@needs_data
@pytest.mark.slow
@pytest.mark.parametrize(("name", "most", "near"), [("single_pendulum", 5, 0.02), ("double_pendulum", 9, 0.012)])
def test_default_settings_tell_a_machine_in_few_terms(name: str, most: int, near: float) -> None:
    model = identify(msgspec.structs.replace(recorded(name), library=Candidates())).model
    assert model.scores.path is not None
    chosen = next(p for p in model.scores.path if p.chosen)
    assert chosen.terms <= most
    assert chosen.error <= near


@pytest.mark.slow
@needs_data
@pytest.mark.parametrize("begin", [6_210, 18_630])
def test_three_seconds_of_a_stage_tell_viscous_from_dry_friction(begin: int) -> None:
    study = recorded("emps")
    run = read_records([Path(f) for f in study.data.files], study.layout()).runs[0]
    library = Candidates(terms=("1", "force", "q_dot", "sign(q_dot)"))
    part = Records((run.part(begin, begin + 3_105),))
    rows = identify(msgspec.structs.replace(study, library=library), part).coefficients
    found = {c.term: c.coefficient for c in rows if c.kind == "term"}
    dry = next(c for term, c in found.items() if term in ("sign(q_dot)", "tanh(q_dot/width_q_dot)"))
    assert found["force"] == pytest.approx(1.0 / 95.1, rel=0.02)
    assert dry == pytest.approx(-20.4 / 95.1, rel=0.1)
    assert -2.6 < found["q_dot"] < -1.6
