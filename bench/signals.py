"""Error of the second derivative over that of the oracle cutoff, for every channel and level of the demo.

    ./run python bench/signals.py --seeds 5

The oracle is the cutoff that is best against the truth, for the same filter. The peers are the same risk from a Hann
window and the paper's noise ceiling (no offset), each on the same filter; the error is taken within the margins.
"""

from __future__ import annotations

import argparse

import numpy as np
import scipy.fft

from odescope import LeastRisk, NoiseCeiling
from odescope.commands.demo import NOISE, PERIOD, simulate_log
from odescope.signals.spectral import differentiate

ORDER = 2


def hann(samples: np.ndarray) -> float:
    """The cutoff of least risk from the record less a line under a Hann window, in hertz."""
    count = len(samples)
    line = np.linspace(samples[0], samples[-1], count)
    power = np.abs(scipy.fft.rfft((samples - line) * np.hanning(count))) ** 2
    floor = np.median(power[len(power) // 2 :]) / np.log(2)
    weight = np.linspace(0.0, 1.0, len(power)) ** (2 * ORDER)
    return float(np.argmin(np.cumsum(weight * (2 * floor - power))) / (count * PERIOD))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--friction", type=float, nargs="+", default=[0.01, 0.15])
    options = parser.parse_args()
    choices = {
        "least risk": lambda s: LeastRisk().hertz([s], PERIOD, ORDER),
        "hann": hann,
        "noise ceiling": lambda s: NoiseCeiling().hertz([s], PERIOD, ORDER),
    }
    ratios: dict[tuple[int, str, str], list[float]] = {}
    for level in NOISE:
        for friction in options.friction:
            for seed in range(options.seeds):
                log = simulate_log(seed, level, friction)
                truth = np.gradient(log.states[:, 2:], PERIOD, axis=0, edge_order=2)
                for k, channel in enumerate(("x", "phi")):
                    samples = log.measured[:, k]

                    def error(hertz: float, samples=samples, truth=truth[:, k]) -> float:
                        margin = round(0.5 / (hertz * PERIOD))
                        bins = round(2 * len(samples) * PERIOD * hertz)
                        found = differentiate(samples, PERIOD, bins, ORDER)[ORDER]
                        return float(np.sqrt(np.mean((found - truth)[margin:-margin] ** 2)))

                    best = min(error(h) for h in np.geomspace(1.0, 40.0, 60))
                    for name, choice in choices.items():
                        ratios.setdefault((level, channel, name), []).append(error(choice(samples)) / best)
    print("level  channel  cutoff          median   90 %   worst")
    for (level, channel, name), values in ratios.items():
        print(
            f"{level:<6} {channel:<8} {name:<14} {np.median(values):7.3f} {np.quantile(values, 0.9):7.3f}"
            f" {np.max(values):7.3f}"
        )


if __name__ == "__main__":
    main()
