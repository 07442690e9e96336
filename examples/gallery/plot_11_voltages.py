"""
Voltages instead of a payload
=============================

The torque constant of a motor is its back-EMF constant, so that a log of currents and voltages gives the drive gains
from motion alone. A weighed payload, here one of 0.2 kg, is another reference, which shares none of its errors.
"""

from pathlib import Path
from tempfile import mkdtemp

import matplotlib.pyplot as plt

import gtau

# %%
# Two motors on a supply of 24 V that sags. Their windings warm up, their bridges lose 1 % of the voltage to dead time,
# and the log holds duties of 12 bits and the supply voltage.
motor = {"resistance": 0.6, "warming": 0.15, "dead_time": 0.01, "duty_quantum": 1 / 2048, "commutation": 0.005}
sensors = {"position_quantum": 1e-5, "current_noise": 0.05}
gains = {"left": 2.62, "right": 3.95}
links = {"m": 1.1, "mx": 0.13, "zz": 0.031, "ia": 0.02, "fv": 0.4, "fs": 0.6}
forearms = {"m": 0.55, "mx": 0.1, "zz": 0.023, "fv": 0.05}
file = {
    "robot": "five-bar",
    "rate": 500,
    "bandwidth": 60,
    "parameters": {
        **{f"{kind}_{side}": value for side in gains for kind, value in links.items()},
        **{f"{kind}_{side}_forearm": value for side in gains for kind, value in forearms.items()},
    },
    "drives": {joint: {"gain": gain} | motor | sensors for joint, gain in gains.items()},
    "supply": {"voltage": 24, "resistance": 0.05},
    "logs": ["duty", "supply_voltage"],
    "runs": [
        {"name": "free", "trajectory": {"sines": {"seed": 1, "duration": 12, "share": 0.8}}},
        {
            "name": "loaded",
            "trajectory": {"sines": {"seed": 2, "duration": 12, "share": 0.8}},
            "payload": {"name": "steel", "mass": 0.2, "parameters": {"mx": 0.06}},
        },
    ],
}
folder = Path(mkdtemp())
*_, experiment = gtau.simulate(file, folder)

# %%
# The free run with voltages, both runs without voltages, and both runs with voltages. The experiment file states the
# efficiency of commutation, 0.5 %; unless stated, 1.5 % is assumed.
text = experiment.read_text()
(folder / "voltages.yaml").write_text(text[: text.index("- log: loaded")])
plain = [line for line in text.splitlines() if not line.strip().startswith(("duty:", "supply_voltage:"))]
(folder / "payload.yaml").write_text("\n".join(plain))
results = {
    "voltages": gtau.identify(folder / "voltages.yaml"),
    "payload": gtau.identify(folder / "payload.yaml"),
    "both": gtau.identify(experiment),
}
print(results["both"].summary(verbose=False))

# %%
# Resistance and back-EMF constant come with the gains.
print(results["both"].motors)

# %%
figure, axes = plt.subplots(1, 2, figsize=(7, 2.2), sharey=True, layout="constrained")
for panel, (joint, truth) in zip(axes, gains.items(), strict=True):
    for row, result in enumerate(results.values()):
        gain = result.drive_gains[joint]
        low, high = gain.interval(0.95)
        panel.plot([low, high], [row, row], linewidth=6, color=f"C{row}", solid_capstyle="butt")
        panel.plot(gain.value, row, "|", color="white", markersize=9)
    panel.axvline(truth, color="0.4", linewidth=1)
    panel.set(title=f"'{joint}'", xlabel="drive gain, N m/A", yticks=range(3), yticklabels=results, ylim=(2.6, -0.6))
