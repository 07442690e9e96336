"""One leg of a quadruped that hangs still, from the MJCF with a floating base as it is shipped."""

from __future__ import annotations

from pathlib import Path

from gtau.result import identify

LEG = ("FL_hip_joint", "FL_thigh_joint", "FL_calf_joint")
PACE = {"FL_hip_joint": 0.400, "FL_thigh_joint": 0.335, "FL_calf_joint": 0.429}
"""Coulomb friction, N m, as the data's authors found it by CMA-ES in a simulator; see the README beside the log."""


def test_a_leg_of_the_file_as_shipped(shared: Path, tmp_path: Path) -> None:
    folder = shared / "aliengo"
    columns = {kind: ", ".join(f"{joint}: {kind}{k}" for k, joint in enumerate(LEG)) for kind in ("q", "tau_pd")}
    (tmp_path / "leg.yaml").write_text(
        f"robot: {{file: {folder / 'aliengo.xml'}, base: fixed, joints: [FL_*]}}\n"
        f"signals: {{time: t, position: {{{columns['q']}}}, torque: {{{columns['tau_pd']}}}}}\n"
        f"runs: [{{log: {folder / 'aliengo.csv'}}}]\n"
    )
    found = identify(tmp_path / "leg.yaml")
    assert found.robot.actuated == LEG
    for joint, friction in PACE.items():
        # the two methods see friction differently; the hips of the four legs are apart by more than half
        assert abs(found.parameters[f"fs_{joint}"].value - friction) < 0.12 * friction
