"""Recognise six joints of a URDF as a floating base."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from xml.etree.ElementTree import Element

from gtau.robots.floating import drawn_base
from gtau.robots.readers.xml_document import decimals
from gtau.robots.robot import Robot


def without_motors_of_base(robot: Robot, root: Element, carried: Mapping[str, str]) -> Robot:
    """Remove the motors of six joints that carry all others and represent a floating base.

    A URDF does not define which joints have motors. These six have none if all joints beyond them have what they lack:
    a transmission (or ros2_control interface), which decides alone, an effort, or the masses of links in between.

    Parameters
    ----------
    robot : Robot
        As its file describes it, every joint with a motor that mimics no other.
    root : Element
        Of the file.
    carried : mapping
        Links by the moving joint whose link they are part of.
    """
    if len(robot.joints) <= 6:
        return robot
    six = drawn_base(
        replace(robot, joints=tuple(replace(each, actuated=k >= 6) for k, each in enumerate(robot.joints)))
    )
    rest = set(robot.actuated).difference(six)
    if not six or not rest:
        return robot
    driven = {
        joint.get("name", "") for parent in ("transmission", "ros2_control") for of in root.iter(parent) for joint in of
    }
    strong = {each.name for each in robot.joints if each.limits.effort}
    heavy = {carried[link.get("name", "")] for link in root.iter("link") if link.get("name") in carried and _mass(link)}
    if rest <= driven:
        drawn = driven.isdisjoint(six)
    else:
        drawn = (rest <= strong and strong.isdisjoint(six)) or (rest <= heavy and heavy.isdisjoint(six[:-1]))
    if not drawn:
        return robot
    joints = (replace(each, actuated=each.actuated and each.name not in six) for each in robot.joints)
    return replace(robot, joints=tuple(joints))


def _mass(link: Element) -> float:
    mass = link.find("inertial/mass")
    return 0.0 if mass is None else next(iter(decimals(mass.get("value", "")) or []), 0.0)
