"""In plain words, how far to trust a model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any


def trust(of: Mapping[str, object]) -> tuple[str, ...]:
    """Return sentences on how far to trust a model, from the scores it was identified with; none where it has none."""
    scores: Any = of
    said = []
    targets = scores.get("targets") or {}
    if targets:
        parts = [f"{share(score['r2_held_out'])} of the variance of {name}" for name, score in targets.items()]
        said.append(f"On held-out data it predicts {_listed(parts)} (R²).")
    run = scores.get("free_run")
    if run:
        whole = run["valid_time"] >= run["duration"]
        said.append(
            "Run freely it stays with the record for "
            + (
                f"all {run['duration']:.4g} s tried."
                if whole
                else f"{run['valid_time']:.3g} of {run['duration']:.4g} s."
            )
        )
        if run["ended"]:
            said.append(f"The free run ended early: {run['ended']}.")
    poles = [n for n, s in targets.items() if s["denominator"]["box"][0] * s["denominator"]["box"][1] <= 0.0]
    if poles:
        said.append(f"Expect poles in {_listed(poles)}.")
    elif targets:
        said.append("No denominator vanishes between the states of the data.")
    likelihood = scores.get("likelihood")
    if likelihood and likelihood["follows"] and not likelihood["process_noise"]:
        ratio = likelihood["residual_variance"]
        said.append(
            f"It follows the record to within its noise: residual variance {ratio:.3f} times that of the noise."
        )
    elif targets and not likelihood:
        said.append("Its coefficients come from regression alone, so they have no standard errors.")
    return tuple(said)


def share(part: float) -> str:
    """Return a part of 1 as a percentage that is not rounded up to the whole."""
    return "more than 99.99 %" if 0.9999 < part < 1.0 else f"{100.0 * part:.2f} %"


def _listed(items: Sequence[str]) -> str:
    return items[0] if len(items) == 1 else f"{', '.join(items[:-1])} and {items[-1]}"
