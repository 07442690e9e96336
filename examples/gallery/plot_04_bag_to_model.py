"""
From a bag to a model
=====================

``gtau identify`` reads ROS bags as they are, drafts the experiment file and identifies, in one command. Here two bags
of ``/joint_states`` are written first.
"""

import subprocess
import sys
from pathlib import Path
from tempfile import mkdtemp

import numpy as np
import polars as pl
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

import gtau
from gtau.demo import write_tutorial

# %%
# Write the bags: positions in rad, motor currents under ``effort``.
folder = Path(mkdtemp())
write_tutorial(folder)
store = get_typestore(Stores.ROS2_HUMBLE)
Time, Header, JointState = (
    store.types[name] for name in ("builtin_interfaces/msg/Time", "std_msgs/msg/Header", "sensor_msgs/msg/JointState")
)
for log, bag in (("empty_1.csv", "empty"), ("loaded_1200g.csv", "loaded_1.2kg")):
    with Writer(folder / bag, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        topic = writer.add_connection("/joint_states", JointState.__msgtype__, typestore=store)
        for t, *q, i_left, i_right in pl.read_csv(folder / log).iter_rows():
            ns = round((100 + t) * 1e9)
            header = Header(Time(*divmod(ns, 10**9)), "")
            state = JointState(header, ["left", "right"], np.array(q), np.zeros(2), np.array([i_left, i_right]))
            writer.write(topic, ns, store.serialize_cdr(state, topic.msgtype))

# %%
# One command. ``--kind`` states that efforts are currents; the payload's mass is in the name of the bag.
command = "identify empty loaded_1.2kg --robot five-bar --kind current --out result"
done = subprocess.run([sys.executable, "-m", "gtau", *command.split()], cwd=folder, capture_output=True, text=True)
print(done.stdout)

# %%
# The model is in ``result/model.json``, the drafted description in ``result/experiment.yaml``.
print((folder / "result/experiment.yaml").read_text())
model = gtau.load(folder / "result/model.json")
figure = model.plot.gains({"left": 2.4, "right": 4.3})
