"""MJCF by ``mujoco.MjSpec``: loops as equality constraints, and actuators whose ``ctrl`` is the motor's current."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any
from xml.etree import ElementTree

import numpy as np

from gtau.documents.files import identifier
from gtau.errors import GtauError, needing
from gtau.estimation.results.result import IdentifiedModel
from gtau.export.consistent import ConsistentModel, consistent_model, differences, friction_comments, term_notes
from gtau.export.exported import Exported, digits, written, xml_text
from gtau.robots.parameter import Parameter
from gtau.robots.robot import GROUND, Robot
from gtau.simulation import mujoco_plant

JOINT = ("range", "armature", "damping", "frictionloss", "stiffness", "springref")
THICKNESS = 0.012  # m: of the links as drawn


def export(result: IdentifiedModel, out: Path) -> Exported:
    """Write ``NAME.xml`` into ``out``; raises GtauError without consistent parameters or MuJoCo."""
    text, said, figures = model_text(imported(), consistent_model(result, "MJCF"))
    return Exported(written(out, {f"{identifier(result.robot.name)}.xml": text}), tuple(said), figures)


def model_text(
    mujoco: ModuleType, model: ConsistentModel, delays: bool = False
) -> tuple[str, list[str], dict[str, float]]:
    """Write a model as MJCF: text, notes (``delays`` are elsewhere), and differences of torques."""
    result = model.result
    spec, expressed = _spec(mujoco, model)
    layout, loops = result.idm.layout, result.idm.loops
    home = mujoco_plant.mujoco_positions(compiled(spec.compile), layout, layout.home if loops is None else loops.home)
    spec.add_key(name="home", qpos=home)  # in which the loops are closed
    compiled(spec.compile)
    figures, difference = differences(model, expressed)
    said = [difference, *notes(model, expressed, delays)]
    springs = [
        spring.name for spring in result.robot.springs if mujoco_plant.spring_attributes(spring, model.values) is None
    ]
    if springs:
        said.append(
            f"no tendon has the force of {', '.join(springs)}: an actuator without gain does, whose ctrl has no effect"
        )
    return _text(mujoco, spec, friction_comments(model)), said, figures


def imported() -> ModuleType:
    """Import the module mujoco; raises GtauError where it is not installed."""
    with needing("an export to MJCF", "mujoco", "mujoco"):
        import mujoco
    return mujoco  # type: ignore[no-any-return, unused-ignore]


def compiled(compile_model: Callable[[], Any]) -> Any:
    """Return the MuJoCo model that a function compiles; raises GtauError where MuJoCo refuses it."""
    try:
        return compile_model()
    except ValueError as error:
        said = " ".join(str(error).split()).rstrip(".")
        raise GtauError(f"MuJoCo refuses the exported model ({said}); identify it with --consistent.") from None


def _spec(mujoco: ModuleType, model: ConsistentModel) -> tuple[Any, dict[str, float]]:
    robot = model.result.robot
    spec = mujoco_plant.robot_spec(mujoco, robot, model.values)
    spec.modelname = robot.name
    spec.option.timestep = mujoco_plant.STEP
    spec.worldbody.add_light(pos=(0, 0, 3))
    expressed = dict(model.values)
    for joint in robot.joints:
        placed = spec.joint(joint.name)
        placed.frictionloss = model.of("fs", joint.name)
        if np.size(placed.damping) == 3:  # since MuJoCo's damping is cubic
            placed.damping = (model.of("fv", joint.name), 0.0, model.of("f3", joint.name))
        else:
            expressed.pop(Parameter("f3", joint.name), None)
        if joint.limits.position is not None:
            placed.range = joint.limits.position
        if not joint.actuated:
            expressed.pop(Parameter("off", joint.name), None)
    _draw(mujoco, robot, spec)
    _add_couplings(mujoco, spec, robot)
    for motor in robot.actuated:  # torque = gear (ctrl + bias), with the drive gain as gear and the current as ctrl
        gear = model.gains[motor]
        bias = -model.of("off", motor) / gear  # the current that cancels the offset, A
        actuator = spec.add_actuator(name=motor, target=motor, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        actuator.gear[0] = gear
        actuator.gainprm[0] = 1.0
        if bias:
            actuator.biastype = mujoco.mjtBias.mjBIAS_AFFINE
            actuator.biasprm[0] = bias
    return spec, expressed


def _draw(mujoco: ModuleType, robot: Robot, spec: Any) -> None:
    """Draw thin capsules from each body's origin to its child bodies, without collision and mass."""
    ends = [(joint.antecedent, joint.placement) for joint in robot.joints]
    ends += [(end.body, end.placement) for closure in robot.closures for end in (closure.a, closure.b)]
    look = {"contype": 0, "conaffinity": 0, "mass": 0.0, "rgba": (0.35, 0.45, 0.6, 1.0)}
    for name, placement in ends:
        shape = {"type": mujoco.mjtGeom.mjGEOM_SPHERE, "size": (1.5 * THICKNESS, 0, 0)}
        if np.linalg.norm(placement.position) > THICKNESS:
            shape = {"type": mujoco.mjtGeom.mjGEOM_CAPSULE, "size": (THICKNESS, 0, 0)}
            shape["fromto"] = (0.0, 0.0, 0.0, *placement.position)
        if name != GROUND:
            spec.body(mujoco_plant.link_name(robot, name)).add_geom(**shape, **look)


def _add_couplings(mujoco: ModuleType, spec: Any, robot: Robot) -> None:
    solref, solimp = mujoco_plant.STIFF
    for number, coupling in enumerate(robot.couplings, start=1):
        if len(coupling.ratios) > 1:
            raise GtauError(
                f"joint '{coupling.joint}' is coupled to {len(coupling.ratios)} joints, and an equality of MuJoCo "
                "couples two; export to urdf or c instead."
            )
        (other, ratio), *_ = coupling.ratios
        tie = spec.add_equality(
            name=f"coupling {number}", name1=coupling.joint, name2=other, objtype=mujoco.mjtObj.mjOBJ_JOINT,
            type=mujoco.mjtEq.mjEQ_JOINT, solref=solref, solimp=solimp,
        )  # fmt: skip
        tie.data[:2] = coupling.offset, ratio
        tie.data[2:5] = 0.0


def _text(mujoco: ModuleType, spec: Any, comments: Sequence[Any]) -> str:
    """Write the spec as XML with full-precision numbers, as MuJoCo writes six digits."""
    root = ElementTree.fromstring(spec.to_xml())
    exact = {
        "body": ({body.name: body for body in spec.bodies}, ("pos", "quat")),
        "joint": ({joint.name: joint for joint in spec.joints}, ("axis", *JOINT)),
        "site": ({site.name: site for site in spec.sites}, ("pos", "quat")),
        "general": ({actuator.name: actuator for actuator in spec.actuators}, ("gear", "gainprm", "biasprm")),
        "spatial": ({tendon.name: tendon for tendon in spec.tendons}, ("stiffness", "springlength", "damping")),
        "key": ({key.name: key for key in spec.keys}, ("qpos",)),
    }
    for element in root.iter():
        named, attributes = exact.get(element.tag, ({}, ()))
        source = named.get(element.get("name", ""))
        for attribute in attributes:
            if source is not None and attribute in element.attrib:
                element.set(attribute, digits(getattr(source, attribute)))
        inertial = element.find("inertial")
        if element.tag == "body" and inertial is not None and source is not None:
            inertial.attrib.clear()
            values = (("mass", "mass"), ("pos", "ipos"), ("quat", "iquat"), ("diaginertia", "inertia"))
            inertial.attrib |= {name: digits(getattr(source, attribute)) for name, attribute in values}
        if element.tag == "option" and "gravity" in element.attrib:
            element.set("gravity", digits(spec.option.gravity))
    couplings = [tie for tie in spec.equalities if tie.type == mujoco.mjtEq.mjEQ_JOINT]
    for element, coupling in zip(root.findall("equality/joint"), couplings, strict=True):
        element.set("polycoef", digits(coupling.data[:5]))
    root[:0] = comments
    return xml_text(root)


def notes(model: ConsistentModel, expressed: Mapping[str, float], delays: bool = False) -> list[str]:
    """List the quantities that the file lacks: friction terms, offsets, massless bodies."""
    said = term_notes(model, "MJCF", expressed, delays)
    offsets = [Parameter("off", joint.name) for joint in model.result.robot.joints]
    if unable := [name for name in offsets if name not in expressed and model.values.get(name)]:
        said.append(f"these offsets are not part of the file: {', '.join(unable)}")
    if light := [joint.name for joint in model.result.robot.joints if not joint.has_mass]:
        said.append(f"MuJoCo moves no massless body, so these weigh {mujoco_plant.LIGHTEST:g} kg: {', '.join(light)}")
    said.append("Coulomb friction is MuJoCo's frictionloss, which also holds the robot at rest")
    return said
