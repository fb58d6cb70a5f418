"""What an observer must know of noise: that of the sensors, and that of the equations."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from odescope.errors import InputError, nearest, said
from odescope.model.model import Model

NUMBERS = int, float, np.integer, np.floating
FIT: Literal["fit"] = "fit"
ProcessNoise = Mapping[str, float] | Literal["fit"] | None  # by target; what makes a log most likely; the model's own


@dataclass(frozen=True)
class ObserverNoise:
    """Standard deviations of noise.

    `measurement` is that of one sample of each coordinate, in its unit; `process` that of what the equations leave out
    of each target, white noise: the root of its spectral density, in the target's unit times the root of a second.
    """

    measurement: Mapping[str, float]
    process: Mapping[str, float]


def measurement_noise(model: Model, given: Mapping[str, float] | None = None) -> dict[str, float]:
    """Return the standard deviation of a sample of every coordinate: as given, else as the model was identified with.

    Raises:
        InputError: a name that is no coordinate, a number that is not positive, or a coordinate without noise.
    """
    told = _checked(given or {}, [c.name for c in model.coordinates], "coordinate", least=0.0)
    found = {c.name: told.get(c.name, _identified(model, c.name)) for c in model.coordinates}
    lacking = [name for name, noise in found.items() if not noise > 0.0]
    if lacking:
        options = " ".join(f"--noise {name}=0.01" for name in lacking)
        raise InputError(
            f"the model does not say how noisy {', '.join(lacking)} {'is' if len(lacking) == 1 else 'are'}; give the"
            f" standard deviation of a sample of each, as in {options}"
        )
    return found


def process_noise(model: Model, given: Mapping[str, float]) -> dict[str, float]:
    """Return the process noise of every target as given, 0 where nothing is.

    Raises:
        InputError: a name that is no target, or a number below zero.
    """
    told = _checked(given, model.targets, "target", least=-1e-300)
    return {target: told.get(target, 0.0) for target in model.targets}


def needs_process_noise(model: Model) -> bool:
    """Say whether the model was found not to follow its own record to within the noise."""
    likelihood = None if model.scores is None else model.scores.likelihood
    return likelihood is not None and likelihood.process_noise is not None


def _identified(model: Model, name: str) -> float:
    """Return the noise of a coordinate when the model was identified, with what the likelihood found beyond; 0 if none.

    What a model leaves over that follows its record without process noise is noise of the sensors, too.
    """
    channels = model.provenance.get("channels")
    channel = channels.get(name) if isinstance(channels, dict) else None
    noise = channel.get("noise") if isinstance(channel, dict) else None
    if isinstance(noise, bool) or not isinstance(noise, int | float) or not np.isfinite(noise):
        return 0.0
    likelihood = None if model.scores is None else model.scores.likelihood
    variance = likelihood.residual_variance if likelihood is not None and likelihood.exact else None
    return float(noise) * float(np.sqrt(max(1.0, variance or 1.0)))


def _checked(given: object, known: list[str] | tuple[str, ...], what: str, least: float) -> dict[str, float]:
    if not isinstance(given, Mapping):
        example = f"{{{known[0]!r}: 0.01}}"
        raise InputError(f"noise must be a number for each {what}, such as {example}; {said(given)} came")
    for name, value in given.items():
        if name not in known:
            raise InputError(f"noise of {name!r}, which is no {what} of the model; {nearest(name, known)}")
        if isinstance(value, bool) or not isinstance(value, NUMBERS) or not least < value < float("inf"):
            wanted = "a positive number" if least == 0.0 else "a number of at least 0"
            raise InputError(f"noise of {name} must be {wanted}, got {value!r}")
    return dict(given)
