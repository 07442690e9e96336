"""
Are my torques true?
====================

Many drivers publish "torques" in N m that are motor currents times a nominal constant. A load of known mass tests them:
the torque scale of a joint is the true torque over the published one, 1 where the driver is right.
"""

from pathlib import Path
from tempfile import mkdtemp

import matplotlib.pyplot as plt
import polars as pl

import gtau
from gtau.demo import write_tutorial

# %%
# A driver that multiplies currents by the constants of the data sheet, 2.4 and 4.3 N m/A (true: 2.62 and 3.95).
folder = Path(mkdtemp())
write_tutorial(folder)
nominal, truth = {"left": 2.4, "right": 4.3}, {"left": 2.62, "right": 3.95}


def published(log: str) -> pl.DataFrame:
    """Return the log as such a driver would have published it."""
    torques = ((pl.col(f"v{joint}") * factor).alias(f"tau_{joint}") for joint, factor in nominal.items())
    return pl.read_csv(folder / log).with_columns(torques).select("t", "^q.*$", "^tau_.*$")


signals = {
    "time": "t",
    "position": {"left": "qleft", "right": "qright"},
    "torque": {"left": "tau_left", "right": "tau_right"},
}
runs = [
    gtau.read_run(published("empty_1.csv"), signals),
    gtau.read_run(published("loaded_1200g.csv"), signals, payload={"name": "steel", "mass": 1.2}),
]

# %%
# The disc of 1.2 kg fixes the scale.
result = gtau.identify(gtau.load_robot("five-bar"), runs)
print(result.summary(verbose=False))

# %%
figure, axes = plt.subplots(figsize=(6, 2), layout="constrained")
for joint, factor in result.drive_gains.items():
    low, high = factor.interval(0.95)
    axes.plot([low, high], [joint, joint], linewidth=6, color="C0")
    axes.plot(truth[joint] / nominal[joint], joint, "k|", markersize=16)
axes.axvline(1, color="0.5", linestyle="--")
axes.set(xlabel="true over published torque (bar: 95 % interval, black: truth)", ylim=(-0.5, 1.5))
