"""
A controller in C
=================

Export the identified model as C code that allocates nothing, compile it, and compute the motors' currents along a log
that the model was not identified from. The folder also holds a computed-torque controller.
"""

import ctypes
import subprocess
from pathlib import Path
from tempfile import mkdtemp

import matplotlib.pyplot as plt
import numpy as np
import polars as pl
from scipy.signal import savgol_filter

import gtau
from gtau.demo import write_tutorial

# %%
# Identify and export.
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
result = gtau.identify(gtau.load_robot("five-bar"), runs)
exported = gtau.export_model(result, "c", folder / "c")
print(*(path.name for path in exported.files))

# %%
# Compile with the C compiler of the system, and call it from Python.
library = folder / "model.so"
subprocess.run(["cc", "-std=c99", "-O2", "-shared", "-fPIC", "-o", library, folder / "c/five_bar.c", "-lm"], check=True)
code = ctypes.CDLL(str(library))
pose, vector = ctypes.create_string_buffer(1 << 10), ctypes.c_double * 2
loaded = code.five_bar_parameters_with_steel
table = pl.read_csv(folder / "check_1200g.csv")
q, qd, qdd = (savgol_filter(table["qleft", "qright"], 21, 5, deriv=k, delta=0.004, axis=0) for k in range(3))
predicted, current = np.empty_like(q), vector()
assert code.five_bar_start(pose, vector(*q[0])) == 0
for k in range(len(q)):
    assert code.five_bar_move(pose, vector(*q[k])) == 0
    code.five_bar_currents(pose, vector(*qd[k]), vector(*qdd[k]), loaded, current)
    predicted[k] = current

# %%
figure, axes = plt.subplots(figsize=(6.5, 2.6), layout="constrained")
axes.plot(table["t"], table["vleft"], color="0.7", linewidth=4, label="logged")
axes.plot(table["t"], predicted[:, 0], label="C code")
axes.set(xlim=(1, 4), xlabel="time, s", ylabel="current of joint left, A")
figure.legend(loc="outside upper center", ncols=2)
