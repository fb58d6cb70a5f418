"""Names as LaTeX."""

from __future__ import annotations

import pytest

from odescope.library.latex import latex_name


@pytest.mark.parametrize(
    ("name", "shown"),
    [
        ("x_dot", r"\dot{x}"),
        ("phi1_ddot", r"\ddot{\phi}_{1}"),
        ("x_ddddddot", "{x}^{(6)}"),
        ("Position_1", r"\mathrm{Position}_{1}"),
        ("Position_1_dot", r"\mathrm{Position\_1\_dot}"),
        ("vx_ddot", r"\mathrm{vx\_ddot}"),
    ],
)
def test_dots_stand_over_single_letters_alone(name, shown):
    assert latex_name(name) == shown
