"""
Weigh a load
============

A robot whose drive gains are identified is a balance: one log with an unknown load, beside one without, gives its mass
with an interval. With the gains of a data sheet the same log gives another mass.
"""

from pathlib import Path
from tempfile import mkdtemp

import matplotlib.pyplot as plt

import gtau
from gtau.demo import write_tutorial

# %%
# Identify the robot first, with a disc of 1.2 kg.
folder = Path(mkdtemp())
write_tutorial(folder)
signals = {
    "time": "t",
    "position": {"left": "qleft", "right": "qright"},
    "current": {"left": "vleft", "right": "vright"},
}
robot = gtau.load_robot("five-bar")
empty = gtau.read_run(folder / "empty_1.csv", signals)
steel = gtau.read_run(folder / "loaded_1200g.csv", signals, payload={"name": "steel", "mass": 1.2})
result = gtau.identify(robot, [empty, steel])

# %%
# A payload without ``mass`` is unknown. Weigh it with the identified gains and with those of the data sheet.
unknown = gtau.read_run(folder / "unknown.csv", signals, payload={"name": "load"})
(load,) = gtau.weigh(result, robot, [empty, unknown])
(by_data_sheet,) = gtau.weigh(result, robot, [empty, unknown], gains="prior", prior_gains={"left": 2.4, "right": 4.3})
print(load)

# %%
# The load was simulated with 0.74 kg.
figure, axes = plt.subplots(figsize=(6, 2), layout="constrained")
for label, weighed in (("data sheet", by_data_sheet), ("identified", load)):
    mass = weighed.parameters["m"]
    low, high = mass.interval(0.95)
    axes.errorbar(mass.value, label, xerr=[[mass.value - low], [high - mass.value]], marker="o", capsize=4)
axes.axvline(0.74, color="0.5", linestyle="--")
axes.set(xlabel="mass of the load, kg (95 % interval; dashed: truth)", ylim=(-0.5, 1.5))
