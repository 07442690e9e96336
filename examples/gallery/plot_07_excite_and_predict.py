"""
Design a motion and predict its intervals
=========================================

``gtau.excite`` designs the motion that identifies the drive gains best within the limits of the robot, and predicts the
standard deviation of every estimate before the robot moves. Here the motion is then simulated and identified.
"""

from pathlib import Path
from tempfile import mkdtemp

import matplotlib.pyplot as plt
import polars as pl

import gtau
from gtau.excitation.forecast import forecast
from gtau.report.design import write_trajectory

# %%
# Two runs of one motion, without and with a disc, 0.3 m along the forearm; the parameters may come from CAD.
folder = Path(mkdtemp())
parameters = {"m_left": 1.0, "mx_left": 0.12, "zz_left": 0.03, "fv_left": 0.4, "fs_left": 0.7}
parameters |= {"m_right": 1.0, "mx_right": 0.12, "zz_right": 0.03, "fv_right": 0.5, "fs_right": 0.6}
parameters |= {"m_left_forearm": 0.5, "mx_left_forearm": 0.09, "zz_left_forearm": 0.021}
parameters |= {"m_right_forearm": 0.5, "mx_right_forearm": 0.09, "zz_right_forearm": 0.021}
disc = {"name": "disc", "mass": 1.2, "parameters": {"mx": 0.36}}
(folder / "design.yaml").write_text(f"""
robot: five-bar
rate: 500                    # Hz
period: 5                    # s
harmonics: 4
repetitions: 2
runs: [{{payload: none}}, {{payload: {disc}}}]
prior:
  gains: {{left: 2.5, right: 4.0}}      # N m/A, the manufacturer's
  noise: {{left: 0.005, right: 0.005}}  # A
  parameters: {parameters}
""")
task, assumed = gtau.read_design(folder / "design.yaml")
design = gtau.excite(task, starts=1)
expected = forecast(task, design.x)
path = write_trajectory(design, folder)

# %%
# Simulate the robot with other gains than the design knew, and identify.
drives = {"left": {"gain": 2.7, "current_noise": 0.005}, "right": {"gain": 3.8, "current_noise": 0.005}}
motion = {"csv": str(path)}
runs = [
    {"name": "free", "trajectory": motion},
    {"name": "loaded", "trajectory": motion, "payload": disc},
]
simulation = {"robot": "five-bar", "rate": 500, "parameters": parameters, "drives": drives, "runs": runs}
result = gtau.identify(gtau.simulate(simulation, folder / "simulated")[-1])
for each, gain in zip(expected.gains, result.drive_gains.values(), strict=True):
    found = 100 * gain.random_std / gain.value
    print(f"{each.name}: random standard deviation {each.relative:.2f} % expected, {found:.2f} % found")

# %%
# The motion that was designed.
table = pl.read_csv(path)
figure, axes = plt.subplots(figsize=(6.5, 2.6), layout="constrained")
axes.plot(table["t"], table["q_left"], label="left")
axes.plot(table["t"], table["q_right"], label="right")
axes.set(xlabel="time, s", ylabel="position, rad")
axes.legend()
