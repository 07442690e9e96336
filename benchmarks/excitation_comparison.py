"""What a design is worth: expected gain deviations against random motions and a condition-number design.

    python benchmarks/excitation_comparison.py benchmarks/excitation_orthoglide.yaml

prints the rms of the relative standard deviations of the drive gains, per cent, as identification's own filters and
rows give them: of a design, of the best of 200 random motions under the same limits and of a design for the condition
number; and compares those of the first design with 100
identifications of simulated logs.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from gtau.errors import GtauError
from gtau.excitation.design import check, excite
from gtau.excitation.design_file import read_design
from gtau.excitation.forecast import forecast
from gtau.excitation.nlp import Programme, random_start
from gtau.excitation.task import DesignProblem

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "support"))
from repetitions import repeated_gains

RANDOM, REPETITIONS = 200, 100


def rms(task: DesignProblem, x: np.ndarray) -> float:
    return float(np.sqrt(np.mean([each.relative**2 for each in forecast(task, x).gains])))


def random_motion(task: DesignProblem, rng: np.random.Generator) -> np.ndarray | None:
    """A random motion that goes as far as the limits let it; None where they do not hold."""
    x = random_start(task, rng, 0.99)
    try:
        return x if x is not None and all(load.excess <= 1 for load in check(task, x)) else None
    except GtauError:
        return None


@threadpool_limits.wrap(limits=1, user_api="blas")
def main() -> None:
    task, assumed = read_design(sys.argv[1])
    print(*assumed, sep="\n")
    rng, began = np.random.default_rng(1), time.perf_counter()
    best = excite(task, "gains", starts=3)
    print(
        f"design for the gains: {rms(task, best.x):.4f} % ({time.perf_counter() - began:.0f} s for 3 starts)",
        flush=True,
    )
    found = repeated_gains(task, best.x, REPETITIONS, rng)
    settled = found[np.isfinite(found).all(axis=1)]
    ratios = settled.std(axis=0, ddof=1) / [each.std for each in forecast(task, best.x).gains]
    print(f"deviations in {len(settled)} simulated experiments over those expected:", np.round(ratios, 3), flush=True)
    programme, motions, tries = Programme(task, "gains", {}), [], 0
    while len(motions) < RANDOM and tries < 20 * RANDOM:
        tries += 1
        x = random_motion(task, rng)
        if x is not None:
            motions.append(programme.value(x)[0])
            if motions[-1] == min(motions):
                champion = x
    print(
        f"best of {len(motions)} random motions within the limits ({tries} tried): {rms(task, champion):.4f} %",
        flush=True,
    )
    began = time.perf_counter()
    x = excite(task, "condition", starts=3).x
    print(f"design for the condition number: {rms(task, x):.4f} % ({time.perf_counter() - began:.0f} s)", flush=True)


if __name__ == "__main__":
    main()
