r"""
Drive gains of a five-bar
=========================

A motor's torque is its drive gain times its current, :math:`\tau = g_\tau v` (eq. 17 of the paper). Two motors drive a
five-bar with a weighed steel disc on its tool. Three logs of 8 s give both drive gains, each with its 95 % interval.
The logs come with gtau and are simulated, so the true gains are known: 2.62 and 3.95 N m/A.
"""

from pathlib import Path
from tempfile import mkdtemp

import matplotlib.pyplot as plt

import gtau
from gtau.demo import write_tutorial

# %%
# Read the logs and say what the columns hold. The disc weighs 1.2 kg: all gains rest on this mass.
folder = Path(mkdtemp())
write_tutorial(folder)
signals = {
    "time": "t",
    "position": {"left": "qleft", "right": "qright"},
    "current": {"left": "vleft", "right": "vright"},
}
runs = [
    gtau.read_run(folder / "empty_1.csv", signals),
    gtau.read_run(folder / "empty_2.csv", signals),
    gtau.read_run(folder / "loaded_1200g.csv", signals, payload={"name": "steel", "mass": 1.2}),
]

# %%
# Identify.
result = gtau.identify(gtau.load_robot("five-bar"), runs)
print(result.summary(verbose=False))

# %%
# The data sheet is 8 and 9 % off; the intervals contain the truth.
truth, data_sheet = {"left": 2.62, "right": 3.95}, {"left": 2.4, "right": 4.3}
figure, axes = plt.subplots(figsize=(6, 2.4), layout="constrained")
for joint, gain in result.drive_gains.items():
    low, high = (100 * (each / truth[joint] - 1) for each in gain.interval(0.95))
    axes.plot([low, high], [joint, joint], linewidth=6, color="C0")
    axes.plot(100 * (data_sheet[joint] / truth[joint] - 1), joint, "s", color="C3")
axes.axvline(0, color="0.5")
axes.set(xlabel="difference from the true gain, %", ylim=(-0.5, 1.5))
axes.legend(["95 % interval", "data sheet"])
