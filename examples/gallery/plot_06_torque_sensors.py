"""
Torque sensors instead of a payload
===================================

A torque sensor between gear and link fixes the scale of the drive gains without weighing anything. One sensor is
enough: the joints share the parameters of the links.
"""

from pathlib import Path
from tempfile import mkdtemp

import matplotlib.pyplot as plt
import numpy as np
import polars as pl
from scipy.signal import savgol_filter

import gtau
from gtau.demo import write_tutorial

# %%
# The logs have no torque sensor: add one to the left joint, between gear and link, with noise of 0.02 N m. It reads the
# torque on the links, whose parameters are those that the logs were simulated with.
folder = Path(mkdtemp())
write_tutorial(folder)
robot = gtau.load_robot("five-bar")
model, noise = gtau.InverseDynamics(robot), np.random.default_rng(1)
links = {
    f"{kind}_{side}": value for kind, value in {"m": 1.1, "mx": 0.13, "zz": 0.031}.items() for side in robot.actuated
}
forearm = {"m": 0.55, "mx": 0.1, "zz": 0.023, "fv": 0.05}
links |= {f"{kind}_{side}_forearm": value for kind, value in forearm.items() for side in robot.actuated}


def with_sensor(log: str) -> pl.DataFrame:
    """Return the log with the column ``tau_left``."""
    table = pl.read_csv(folder / log)
    q, qd, qdd = (
        savgol_filter(table["qleft", "qright"], 21, 5, deriv=order, delta=0.004, axis=0) for order in range(3)
    )
    tau = model.torques(q, qd, qdd, links)[:, 0]
    return table.with_columns(tau_left=tau + noise.normal(0, 0.02, len(tau)))


signals = {
    "time": "t",
    "position": {"left": "qleft", "right": "qright"},
    "current": {"left": "vleft", "right": "vright"},
    "joint_torque": {"left": "tau_left"},
    "calibration": {"joint_torque": 0.005},  # relative standard deviation of the sensor's scale
}
runs = [gtau.read_run(with_sensor(log), signals) for log in ("empty_1.csv", "empty_2.csv")]

# %%
# Both runs are without load.
result = gtau.identify(robot, runs)
print(result.summary(verbose=False))

# %%
figure, axes = plt.subplots(figsize=(6, 2), layout="constrained")
for joint, truth in {"left": 2.62, "right": 3.95}.items():
    low, high = result.drive_gains[joint].interval(0.95)
    axes.plot([100 * (low / truth - 1), 100 * (high / truth - 1)], [joint, joint], linewidth=6, color="C0")
axes.axvline(0, color="0.5")
axes.set(xlabel="95 % interval of the drive gain, % from the truth", ylim=(-0.5, 1.5))
