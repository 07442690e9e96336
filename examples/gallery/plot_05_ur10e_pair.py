"""
A pair of UR10e runs
====================

Two runs of one motion, without and with a payload of known mass, give all six drive gains of a UR10e. The payload is
mounted off the axis of the last wrist, which would lift nothing otherwise. The logs are simulated at 125 Hz on the
geometry of the catalog.
"""

from pathlib import Path
from tempfile import mkdtemp

import matplotlib.pyplot as plt
import numpy as np

import gtau

# %%
# True masses (kg), friction and gains (N m/A) of the size that a real UR10e has.
robot = gtau.load_robot("ur10e")
joints = robot.actuated
gains = dict(zip(joints, (12.0, 12.4, 9.7, 10.8, 10.6, 10.3), strict=True))
links = {"m": (7.8, 12.9, 3.9, 2.0, 2.0, 0.2), "mx": (0.0, 4.0, 1.1, 0.0, 0.0, 0.0)}
links |= {"xx": (0.04, 0.1, 0.02, 0.006, 0.006, 0.001), "yy": (0.04, 1.8, 0.5, 0.006, 0.006, 0.001)}
links |= {"zz": (0.03, 1.8, 0.5, 0.006, 0.006, 0.001), "ia": (6.0, 6.0, 1.6, 0.5, 0.5, 0.5)}
links |= {"fv": (17.0, 25.0, 9.0, 3.4, 1.8, 2.7), "fs": (14.0, 11.0, 5.7, 2.8, 3.2, 2.5)}
parameters = {f"{kind}_{joint}": value for kind in links for joint, value in zip(joints, links[kind], strict=True)}
center = dict(zip(joints, (0.0, -1.6, 1.2, -1.2, 0.0, 0.0), strict=True))
draw = np.random.default_rng(1)
frequencies = (0.08, 0.15, 0.24)
sizes = np.array([[1.0, 0.5, 0.5, 0.8, 0.8, 0.8], [0.5, 0.25, 0.3, 0.4, 0.4, 0.4], [0.3, 0.15, 0.2, 0.25, 0.3, 0.3]])
motion = {
    "fourier": {
        "duration": 30,
        "frequency": frequencies,
        "center": center,
        "amplitude": {joint: tuple(sizes[:, k]) for k, joint in enumerate(joints)},
        "phase": {joint: tuple(draw.uniform(-3, 3, 3)) for joint in joints},
    }
}
payload = {
    "name": "disc",
    "mass": 5.0,
    "parameters": {"mx": 0.75, "mz": 0.9, "xx": 0.18, "xz": -0.13, "yy": 0.3, "zz": 0.13},
}
written = gtau.simulate(
    {
        "robot": "ur10e",
        "parameters": parameters,
        "drives": {joint: {"gain": gain, "current_noise": 0.03} for joint, gain in gains.items()},
        "rate": 125,
        "runs": [
            {"name": "empty", "trajectory": motion},
            {"name": "loaded", "trajectory": motion, "payload": payload},
        ],
    },
    Path(mkdtemp()),
)

# %%
result = gtau.identify(written[-1])
print(result.summary(verbose=False))

# %%
# Estimates against the truth.
figure, axes = plt.subplots(figsize=(6.5, 3), layout="constrained")
for joint, gain in result.drive_gains.items():
    axes.plot([100 * (each / gains[joint] - 1) for each in gain.interval(0.95)], [joint] * 2, linewidth=6, color="C0")
axes.axvline(0, color="0.5")
axes.set(xlabel="95 % interval of the drive gain, % from the truth")
axes.invert_yaxis()
