"""FIGAROH by a subclass of its BaseIdentification, as figaroh-examples have one a robot, with weighted least squares.

The configuration has the model components and the solver of the example of the TX40; a motor that turns with two joints
gets the columns of that example. Torques along other logs come from its regressor and base parameters.
"""

import logging
import re

import numpy as np
import yaml
from exchange import Task
from figaroh.identification.base_identification import BaseIdentification
from figaroh.identification.identification_tools import base_param_from_standard
from figaroh.tools.regressor import build_regressor_basic, build_regressor_reduced
from figaroh.tools.robot import load_robot

logging.disable(logging.CRITICAL)
task = Task()
n = len(task.joints)
if n == 1:
    task.refuse("an IndexError with one joint")
# Hz: of 5 to 100 bandwidths of the motion, 100 left the least errors on UR10e, TX40 and Panda together
cutoff = min(5 * task.cutoff, 0.45 * task.rate)
zero = [0.0] * n
config = {
    "robot": {
        "name": "robot",
        "properties": {
            "joints": {"active_joints": task.joints},
            "mechanics": {
                "friction_coefficients": {"viscous": zero, "static": zero},
                "actuator_inertias": zero,
                "joint_offsets": zero,
                "reduction_ratios": [1.0] * n,
            },
            "coupling": {"has_coupled_wrist": False},
        },
    },
    "tasks": {
        "identification": {
            "enabled": True,
            "problem": {
                "include_external_forces": False,
                "use_joint_torques": True,
                "wls": True,
                "model_components": {"friction": True, "joint_offset": True, "actuator_inertia": True},
            },
            "signal_processing": {"sampling_frequency": task.rate, "cutoff_frequency": cutoff, "filter_order": 4},
        }
    },
}
path = task.folder / "figaroh.yaml"
path.write_text(yaml.safe_dump(config))
motors = np.array(task.motors)
coupled = [j for j in range(n) if np.count_nonzero(abs(motors[j]) > 1e-9) > 1]


class Identification(BaseIdentification):
    """Reads the log that it is given; rows at both ends are left out as in the example."""

    def __init__(self, robot, config_file, log):
        super().__init__(robot, config_file)
        self.log = log
        self.identif_config["act_Jid"] = [self.model.getJointId(name) for name in task.joints]
        joints = [self.model.joints[k] for k in self.identif_config["act_Jid"]]
        self.identif_config["act_idxq"] = [joint.idx_q for joint in joints]
        self.identif_config["act_idxv"] = [joint.idx_v for joint in joints]
        self.filter_config = {
            "differentiation_method": "gradient",
            "filter_params": {"nbutter": 4, "f_butter": cutoff, "f_sample": task.rate},
        }

    def load_trajectory_data(self, data_source=None):
        empty = dict.fromkeys(("velocities", "accelerations"))
        t, q, tau = (self.log[key] for key in ("t", "q", "tau"))
        return {"timestamps": t[:, None], "positions": q, "torques": tau, **empty}

    def process_torque_data(self):
        for name, values in self.processed_data.items():
            self.processed_data[name] = values[20:-20]
        return self.raw_data["torques"][20:-20]

    def _compute_validation_metrics(self):
        """Its validation builds the regressor without columns of coupled motors."""

    def calculate_full_regressor(self):
        self.dynamic_regressor = self.columns()

    def initialize_standard_parameters(self):
        super().initialize_standard_parameters()
        self.standard_parameter |= {f"{kind}_motor_{j}": 0.0 for j in coupled for kind in ("Ia", "fv", "fs")}

    def columns(self):
        q, qd, qdd = (self.processed_data[kind] for kind in ("positions", "velocities", "accelerations"))
        W = [build_regressor_basic(self.robot, q, qd, qdd, self.identif_config)]
        for j in coupled:
            a, v = qdd @ motors[j], qd @ motors[j]
            W.append(np.concatenate([share * np.stack([a, v, np.sign(v)], axis=1) for share in motors[j]]))
        return np.hstack(W)

    def predict(self, log):
        self.log = log
        self.process_data()
        W = build_regressor_reduced(self.columns(), self._idx_eliminated)[:, self._base_indices]
        return np.pad((W @ self.phi_base).reshape(n, -1).T, ((20, 20), (0, 0)), mode="edge")


robot = load_robot(task.geometry, load_by_urdf=True)
tool = Identification(robot, str(path), task.fit[0])
tool.initialize()
phi = tool.solve(decimate=True, decimation_factor=task.factor, plotting=False, wls=True)
verdict = tool.verify(scope="execution")
found = {"alarms": [] if verdict.passed else ["verify: execution"]}
if task.truth:
    named = {
        re.sub("^I?(xx|xy|xz|yy|yz|zz)_", r"I\1_", name).replace("ia_", "Ia_"): v for name, v in task.truth.items()
    }
    true = base_param_from_standard(dict.fromkeys(tool.standard_parameter, 0.0) | named, tool.params_base)
    half = 1.96 * np.abs(phi) * np.asarray(tool.result["wls_std_deviations"]) / 100
    found["held"] = [int((np.abs(phi - true) <= half).sum()), len(phi)]
task.answer(tool.predict, **found)
