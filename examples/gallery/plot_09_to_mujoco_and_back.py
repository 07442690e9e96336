"""
To MuJoCo and back
==================

Identify physically consistent parameters, export them as an MJCF file, let MuJoCo integrate the robot under control,
and identify it again from these logs: the gains come back.
"""

from pathlib import Path
from tempfile import mkdtemp

import matplotlib.pyplot as plt
import mujoco

import gtau
from gtau.demo import write_tutorial

# %%
# Export needs parameters that each body can have: ``consistent=True``.
folder = Path(mkdtemp())
write_tutorial(folder)
signals = {
    "time": "t",
    "position": {"left": "qleft", "right": "qright"},
    "current": {"left": "vleft", "right": "vright"},
}
runs = [
    gtau.read_run(folder / "empty_1.csv", signals),
    gtau.read_run(folder / "loaded_1200g.csv", signals, payload={"name": "steel", "mass": 1.2}),
]
result = gtau.identify(gtau.load_robot("five-bar"), runs, consistent=True)
exported = gtau.export_model(result, "mjcf", folder / "mjcf")
print(*exported.notes, sep="\n")

# %%
# MuJoCo reads the file; its controls are motor currents in A.
(file,) = (path for path in exported.files if path.suffix == ".xml")
scene = mujoco.MjModel.from_xml_path(str(file))
print(f"bodies: {scene.nbody - 1}, equality constraints: {scene.neq}, motors: {scene.nu}")

# %%
# MuJoCo integrates the identified robot, friction included, under a controller; its logs are identified again.
payload = {"name": "steel", "mass": 1.2, "parameters": {"mx": 0.36, "xx": 0.001, "yy": 0.11, "zz": 0.11}}
simulation = {
    "robot": "five-bar",
    "parameters": dict(result.consistency.standard),
    "engine": "mujoco",
    "rate": 250,
    "drives": {joint: {"gain": gain.value, "current_noise": 0.02} for joint, gain in result.drive_gains.items()},
    "runs": [
        {"name": "empty", "trajectory": {"sines": {"seed": 1, "duration": 8, "share": 0.8}}},
        {"name": "loaded", "trajectory": {"sines": {"seed": 3, "duration": 8, "share": 0.8}}, "payload": payload},
    ],
}
again = gtau.identify(gtau.simulate(simulation, folder / "simulated")[-1])

# %%
figure, axes = plt.subplots(figsize=(6, 2), layout="constrained")
for joint, gain in again.drive_gains.items():
    truth = result.drive_gains[joint].value
    axes.plot([100 * (each / truth - 1) for each in gain.interval(0.95)], [joint, joint], linewidth=6, color="C0")
axes.axvline(0, color="0.5")
axes.set(xlabel="95 % interval of the gain from MuJoCo's logs, % from the exported one", ylim=(-0.5, 1.5))
