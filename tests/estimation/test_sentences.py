"""The words of every kind of finding, each asserted once: tests elsewhere assert kinds, joints and values."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest
from pydantic import TypeAdapter

from gtau.findings import Finding, Grade, Severity
from gtau.findings import FindingKind as F
from gtau.findings.finding import finding_document, named_causes
from gtau.findings.words import filled, percents, phrase, templates

NO_GRAVITY = (
    "log the torques of the motors (UR: 'use_currents_as_efforts: true'), or write 'robot: {file: ..., gravity: [0, 0, "
    "0]}' in the experiment file for a model without gravity"
)
GEARS = (
    "write 'motor_torque' with the 'gear_ratio' of each joint instead of 'torque', or 'current' if they are in A, or "
    "correct the limits"
)
ADVICE = "compare the encoder zeros with the robot's zero position"
ZERO = Finding("encoder zeros", ("left",), values={"what": "an error in the zero of encoder 'left'", "action": ADVICE})
FALLING = Finding(
    "saturation", values={"what": "the torque constant of 'left' falling with its current", "action": "log the current"}
)
# fmt: off
SENTENCES = [  # finding, reason, advice
    (Finding(F.NEGATIVE_MASS, (), "m_trunkR", values={"mass": -41.23}),
     "the wrenches imply a robot mass of -41.2 kg",
     "log the forces exerted on the body, not by it, or reverse their signs"),
    (Finding(F.BASE_UNEXPLAINED, (), "trunk", values={"share": 0.42, "part": "moments"}),
     "the model leaves 42 % of the moments on the base 'trunk' unexplained",
     "check the signs, axes, point ('at') and body of each wrench, that no wrench is missing, and that all use the "
     "clock of the positions"),
    (Finding(F.TLS_CONFUSED),
     "total least squares cannot separate the payload from the noise (standard deviation over 50 %)",
     "use --method ml, or a heavier payload and longer runs with less noise"),
    (Finding(F.ALL_NEGATIVE),
     "all drive gains are negative",
     "check the sign of the currents and positions, gravity, which runs carry the payload, and on which body"),
    (Finding(F.REFUTED, ("left",),
     values={"size": 1.2, "unit": "deg", "share": 0.31, "move": -0.045},
     causes=(ZERO,)),
     "an error in the zero of encoder 'left' (1.2 deg) would explain 31 % of the residual variance and move this "
     "gain by -4.5 %",
     "compare the encoder zeros with the robot's zero position"),
    (Finding(F.REFUTED, ("left",),
     values={"size": 1.2, "unit": "deg", "share": 0.31, "move": -23.0},
     causes=(ZERO,)),
     "an error in the zero of encoder 'left' (1.2 deg) would explain 31 % of the residual variance and move this "
     "gain by more than 1000 %",
     "compare the encoder zeros with the robot's zero position"),
    (Finding(F.FROZEN, ("elbow", "wrist"), values={"run": "b", "kind": "current", "share": 0.26, "usual": 0.018}),
     "the position of 'elbow' never changes in run 'b', but 26 % of the current of 'wrist' is then unexplained, 1.8 % "
     "in other runs, so it moved",
     "check the encoder and the position column of 'elbow' in that run, and log it again"),
    (Finding(F.UNEXPLAINED, ("left",), values={"share": 0.31, "kind": "current", "given": False}),
     "the model leaves 31 % of the joint's current unexplained",
     "check that the position and current columns are of the same joint in all runs, and check their signs and units"),
    (Finding(F.UNEXPLAINED, ("left",), values={"share": 0.31, "kind": "current", "given": False, "stated": True}),
     "the model leaves 31 % of the joint's current unexplained",
     "check the known parameters, on which the scale rests ('priors', 'prior_inertias' and the inertias in the robot's "
     "file), then the columns, their signs and units"),
    (Finding(F.UNEXPLAINED, ("left",), values={"share": 0.61, "kind": "torque", "given": True}),
     "the model leaves 61 % of the joint's torque unexplained",
     "check the position and torque columns, their signs and units, the clock of the log, and 'preparation'"),
    (Finding(F.PAYLOAD, ("left",), "steel"),
     "the scale comes from payload 'steel', which contradicts the data",
     "correct the payload"),
    (Finding(F.PAYLOAD, ("left",), "steel", {"given": True}),
     "payload 'steel', which contradicts the data, leaves this joint unexplained",
     "correct the payload"),
    (Finding(F.SENSOR, ("left",), "right"),
     "the scale comes from the torque sensor of 'right', which contradicts all other data",
     "check the sensor's calibration, unit and joint; a payload's mass or a known parameter may be wrong too"),
    (Finding(F.SENSOR, ("left",), "right", {"sensor": "cable sensor"}),
     "the scale comes from the cable sensor of 'right', which contradicts all other data",
     "check the sensor's calibration, unit and joint; a payload's mass or a known parameter may be wrong too"),
    (Finding(F.WHOLE_MASS, ("left",), "m_trunkR",
     values={"found": 41.2, "std": 0.3, "prior": 40.0, "prior_std": 0.1}),
     "the mass of the robot, m_trunkR, is 41.2 from the data (standard deviation 0.3), but 40 from its prior (0.1)",
     "check its value, and the units and signs of the other scale references: payloads, sensors, wrenches"),
    (Finding(F.UNSETTLED),
     "the iteration did not converge, so the data do not determine it",
     "resolve the contradictory joints first"),
    (Finding(F.LOST, values={"std": 0.8, "payload": True}),
     "the relative standard deviation is 80 %",
     "use a heavier payload, and motions in which the joint lifts or accelerates it; check the direction of "
     "gravity, which runs carry the payload, and on which body"),
    (Finding(F.SIGN_OPEN, values={"payload": False}),
     "the 95 % interval includes zero",
     "use longer runs, motions in which the joint lifts or accelerates more, or also a payload of known mass; "
     "check the direction of gravity"),
    (Finding(F.PRIOR_GAIN, ("left",), values={"ratio": 1003.0, "prior": 2.0, "unit": "N m/A"}),
     "the gain is 1003 times its prior of 2 N m/A",
     "check the payload's mass (g entered as kg?) and the unit of the currents (A declared as mA?)"),
    (Finding(F.PRIOR_GAIN, ("left",), values={"ratio": 0.001, "prior": 2.0, "unit": "N m/A"}),
     "the gain is 0.001 times its prior of 2 N m/A",
     "check the unit of the currents (mA declared as A?) and the payload's mass in kg"),
    (Finding(F.PRIOR_GAIN, ("left",), values={"ratio": 3.0, "prior": 2.0, "unit": "N m/A"}),
     "the gain is 3 times its prior of 2 N m/A",
     "check the payload's mass (kg), the unit of the currents, and 'prior_gains'"),
    (Finding(F.EFFORT, ("left",), "left",
     {"torque": 250.0, "limit": 100.0, "ratio": 2.5, "unit": "N m", "all": True, "given": False, "kind": "current"}),
     "the torque of 'left' is 250 N m (rms), 2.5 times its limit of 100 N m, so the payload's mass, which sets "
     "the scale, may be wrong",
     "check the payload's mass (kg) and the unit of the currents; if the limit is a placeholder, state the real one "
     "under 'robot' in the experiment file ({file: ..., limits: {left: ...}})"),
    (Finding(F.DOUBTFUL_LIMIT, ("left",), "left",
     {"torque": 250.0, "limit": 100.0, "ratio": 2.5, "unit": "N m", "all": False, "given": False, "kind": "current"}),
     "the torque of 'left' is 250 N m (rms), 2.5 times its limit of 100 N m",
     "check the payload's mass (kg) and the unit of the currents; if the limit is a placeholder, state the real one "
     "under 'robot' in the experiment file ({file: ..., limits: {left: ...}})"),
    (Finding(F.WIDE_SCALE, ("left",), values={"half": 0.051, "accuracy": 0.03, "random": True, "payload": True}),
     "the 95 % interval is +-5.1 %, limited by the uncertainty of the scale reference",
     "calibrate the sensors, or weigh the payload, more accurately"),
    (Finding(F.WIDE_RANDOM, ("left",), values={"half": 0.051, "accuracy": 0.03, "random": True, "payload": True}),
     "the 95 % interval is +-5.1 %",
     "use a heavier payload, longer runs, or motions in which the joint lifts or accelerates it more; if other "
     "joints are weak too, check which runs carry the payload, on which body, and gravity"),
    (Finding(F.WIDE_RANDOM, ("left",), values={"half": 0.051, "accuracy": 0.03, "random": True, "payload": False}),
     "the 95 % interval is +-5.1 %",
     "use longer runs, motions in which the joint lifts or accelerates more, or also a payload of known mass; "
     "check the direction of gravity"),
    (Finding(F.WIDE_CAUSE, ("left",),
     values={"half": 0.051, "accuracy": 0.03, "random": True, "payload": False},
     causes=(FALLING,)),
     "the 95 % interval is +-5.1 %, because the data cannot exclude the torque constant of 'left' falling with its "
     "current",
     "log the current; also use longer runs"),
    (Finding(F.WIDE_SCALE, ("left",),
     values={"accuracy": 0.03, "half": 0.2, "each": [["left", {"half": 0.2}], ["right", {"half": 0.05}]]}),
     "the 95 % intervals are +-20 % ('left'), +-5.0 % ('right'), limited by the uncertainty of the scale reference",
     "calibrate the sensors, or weigh the payload, more accurately"),
    (Finding(F.REFUTED, ("left",),
     values={"size": 1.2, "unit": "deg", "share": 1.0, "each": [["left", {"move": -23.0}], ["right", {"move": 0.05}]]},
     causes=(ZERO,)),
     "an error in the zero of encoder 'left' (1.2 deg) would explain 100 % of the residual variance and move the gains "
     "by more than 1000 % ('left'), +5 % ('right')",
     "compare the encoder zeros with the robot's zero position"),
    (Finding(F.COUPLED, ("left",), "right"),
     "joint 'right' contradicts the model, whose parameters all joints share",
     "resolve that joint first"),
    (Finding(F.NEGATIVE_GAIN, ("left",), values={"kind": "current", "negative": True, "prior": False}),
     "negative gain: positive current drives the joint backwards",
     "reverse the sign of its current or position column; or if the drive does turn against its joint, state a "
     "negative prior gain"),
    (Finding(F.NEGATIVE_GAIN, ("left",), values={"kind": "torque", "negative": False, "prior": True}),
     "positive gain: positive torque drives the joint forwards",
     "reverse the sign of its torque or position column; or if that is intended, reverse the prior gain"),
    (Finding(F.DELAY_NOISE),
     "the current's rate of change may be nothing but noise",
     "treat it as unknown, or move this joint faster; the drive gain does not depend on it"),
    (Finding(F.DELAY_UNCERTAIN, values={"std": 0.012}),
     "its standard deviation is 12 ms",
     "treat it as a nuisance parameter, or move this joint faster"),
    (Finding(F.INSEPARABLE),
     "these motions cannot separate it from the parameters listed before it",
     "add runs with different motions of the joints"),
    (Finding(F.NEAR_ZERO),
     "it is within two standard deviations of zero",
     "treat it as small, or move its joint faster and further"),
    (Finding(F.UNCERTAIN, values={"std": 0.3}),
     "its standard deviation is 30 %",
     "add longer runs"),
    (Finding(F.IMPOSSIBLE, values={"t": 11.0, "friction": True}),
     "it is negative by 11 standard deviations: friction that drives the joint",
     "check the signs of positions and currents, the sampling rate, the units and 'preparation'"),
    (Finding(F.IMPOSSIBLE, values={"t": 11.0, "friction": False}),
     "it is negative by 11 standard deviations: a negative inertia",
     "check the signs of positions and currents, the sampling rate, the units and 'preparation'"),
    (Finding(F.PAYLOAD_MASS, values={"parameter": "m", "declared": 2.0, "found": 2.05, "std": 0.01, "unit": "kg"}),
     "all other data give it a mass of 2.05 kg (standard deviation 0.01), not 2 kg",
     "reweigh the payloads: a mass is wrong, or a run carries a payload other than declared"),
    (Finding(F.PAYLOAD_MASS,
     values={"parameter": "m", "declared": 2.0, "found": 2.05, "std": 0.01, "unit": "kg", "given": "torque"}),
     "all other data give it a mass of 2.05 kg (standard deviation 0.01), not 2 kg",
     "check which runs carry the payload, its mass (kg) and the unit and scale of the torques; if the mass is "
     "certain, use --method ml: it then sets their scale"),
    (Finding(F.PAYLOAD_MASS,
     values={"parameter": "m", "declared": 2.0, "found": 2.05, "std": 0.01, "unit": "kg", "given": "current"}),
     "all other data give it a mass of 2.05 kg (standard deviation 0.01), not 2 kg",
     "check which runs carry the payload, its mass (kg) and the given gains; if the mass is certain, identify "
     "the gains: it then sets their scale"),
    (Finding(F.PAYLOAD_PARAMETER,
     values={"parameter": "mx", "declared": 0.3, "found": 0.2, "std": 0.01, "unit": "kg m"}),
     "given its mass and all other data, its mx is 0.2 kg m (standard deviation 0.01), not 0.3 kg m",
     "check mx, its frame (that of the body that carries the payload) and the mass; or omit mx"),
    (Finding(F.PAYLOAD_PARAMETER,
     values={"parameter": "mx", "declared": 0.05, "found": 0.0995, "std": 0.001, "unit": "kg m", "moment": 0.1}),
     "given its mass and all other data, its mx is 0.0995 kg m (standard deviation 0.001), not 0.05 kg m",
     "if 0.05 is in m, write 'mx: 0.1' (mass times distance, kg m); otherwise check mx, its frame (that of the body "
     "that carries the payload) and the mass; or omit mx"),
    (Finding(F.SENSOR_SCALE, values={"scale": 1.051, "std": 0.004}),
     "all other data give torques 1.051 times its reading (standard deviation 0.004)",
     "check the sensor's calibration, unit and joint; a payload's mass or a known parameter may be wrong too"),
    (Finding(F.UNLIKE_LEGS, (), "11", values={"parameter": "mx_12R", "share": 0.4}),
     "legs of the same geometry differ, most in mx_12R of leg '11' (40 % from the mean of the others)",
     "check that they are built identically"),
    (Finding(F.UNLIKE_LEGS, (), "11", values={"parameter": "mx_12R", "share": 40.0}),
     "legs of the same geometry differ, most in mx_12R of leg '11' (more than 1000 % from the mean of the others)",
     "check that they are built identically"),
    (Finding(F.PRIOR, (), "mx_3", values={"found": 41.2, "std": 0.3, "prior": 40.0, "prior_std": 0.1}),
     "the known parameter mx_3 is 41.2 from the data (standard deviation 0.3), but 40 from its prior (0.1)",
     "check its value, and the units and signs of the other scale references: payloads, sensors, wrenches"),
    (Finding(F.SMALL_REFUTATION,
     values={"share": 0.12, "move": 0.0071},
     causes=(ZERO,)),
     "an error in the zero of encoder 'left' would explain 12 % of the residual variance and move no gain by more than "
     "0.71 %",
     "compare the encoder zeros with the robot's zero position"),
    (Finding(F.NO_GRAVITY_SHOWN, values={"felt": 0.0031}),
     "the data do not show whether the torques contain gravity (0.3 % of a joint's torque at most): it hardly varies "
     "along these motions, the robot is balanced, or a driver compensates it",
     f"if a driver compensates it, {NO_GRAVITY}"),
    (Finding(F.NO_GRAVITY_SHOWN, values={"felt": 0.031, "own": "current"}),
     "the data do not show whether the torques contain gravity (3 % of a joint's torque at most): it hardly varies "
     "along these motions, the robot is balanced, or a driver compensates it",
     "if a driver compensates it, log the actual currents of the motors, or write 'robot: {file: ..., gravity: [0, 0, "
     "0]}' in the experiment file for a model without gravity"),
    (Finding(F.WHOLE_NUMBERS, values={"kind": "torque", "largest": 873.0}),
     "the torques are whole numbers, up to 873: ‰ of the rated torque (CiA 402, object 0x6077), mA, counts, or SI "
     "units without decimals",
     "state their unit and the rated values (units: {torque: ‰, rated: {...}}), or {torque: mA}; in SI units, log them "
     "with decimals"),
    (Finding(F.MOTOR_SIDE, values={"least": 83.2, "most": 138.4}),
     "the true torques are 83.2 to 138 times those logged: by their size they are motor-side torques (before the "
     "gear) or currents",
     GEARS),
    (Finding(F.MOTOR_SIDE, values={"least": 100.1, "most": 100.2}),
     "the true torques are 100 times those logged: by their size they are motor-side torques (before the gear) or "
     "currents",
     GEARS),
    (Finding(F.MOTOR_SIDE, ("left",), values={"share": 0.0031, "limit": 150.0}),
     "the torques reach 0.31 % of the limit of 'left' (150), and less for all others: by their size they are "
     "motor-side torques (before the gear) or currents",
     GEARS),
    (Finding(F.MODEL_TORQUES, values={"kind": "torque", "friction": 0.003, "residual": 0.0057}),
     "the torques have next to no friction (0.3 % of a joint's torque at most) and 0.57 % is unexplained: they come "
     "from a model in the controller, not from the motors",
     "log measured currents or torques (UR: actual_current, not target_current or target_moment)"),
    (Finding(F.SCALE_UNTESTED, values={"why": "no joint shows it"}),
     "the torques are assumed to be correct, because their scale could not be tested: no joint shows it",
     "add runs with a heavier payload of known mass, or longer ones"),
    (Finding(F.SCALE_UNTESTED, (), "yaw", {"payloads": ["105 g", "205 g"]}),
     "the torques are assumed to be correct, because their scale could not be tested: no joint torque shows the mass "
     "of '105 g' or '205 g' by itself on 'yaw'",
     "check 'tool' of the robot, which carries the payload, or state the payload's 'center'"),
    (Finding(F.NO_BODIES, values={"why": "the search did not converge"}),
     "physically consistent parameters were not found: the search did not converge",
     ""),
    (Finding(F.COMMON_SCALE, (), "steel", {"scale": 1.25, "std": 0.012, "mass": 0.96, "declared": 1.2}),
     "one factor, 1.25 (standard deviation 0.012), explains the torque scale of all joints; a mass of 0.96 kg for "
     "payload 'steel' (stated: 1.2 kg) would explain it equally",
     "reweigh the payload before you correct the torques"),
    (Finding(F.GAINS_APART, ("a",), "b",
     {"ratio": 61.2, "gain": 0.2, "of_peer": 12.24, "unit": "N m/A", "kind": "current"}),
     "the gains of 'a', 0.2 N m/A, and 'b', 12.2 N m/A, differ by a factor of 61, which is implausible for motors and "
     "gears of one robot",
     "check that the current columns of these joints are in the same unit, and convert those that are not; if the "
     "motors do differ, state 'prior_gains'"),
    (Finding(F.CURRENTS_APART, ("a",), "b", {"larger": 478.0, "smaller": 8.1}),
     "the current of joint 'a' is 59 times that of 'b' (478 and 8.1 A rms)",
     "check that the columns are in the same unit (A, mA, % or counts), and convert those that are not"),
    (Finding(F.LARGE_CURRENT, ("a",), "a", {"rms": 8099.0}),
     "the current of joint 'a' is 8099 A rms, more than drives of robots take",
     "if it is in mA, write units: {current: mA}; otherwise state 'prior_gains'"),
    (Finding(F.SMALL_CURRENT, ("a", "b"), "a", {"rms": 0.0072}),
     "no current is larger than that of joint 'a', 0.0072 A rms, less than drives of robots take",
     "check the unit of the currents (A stated as mA?) and the payload's mass (kg); if both are right, state "
     "'prior_gains'"),
    (Finding(F.SMALL_CURRENT, (), "a", {"gain": 11378.0, "unit": "N m/A", "volts": 5737.0}),
     "the gain of 'a', 1.138e+04 N m/A, would induce 5.74e+03 V in its motor at the logged speed (rms), more than "
     "drives of robots supply",
     "check the unit of the currents (A stated as mA?) and the payload's mass (kg); if both are right, state "
     "'prior_gains'"),
    (Finding(F.STRENGTH, values={"strength": 9.0}),
     "gravity is 9 m/s2 in the robot's description, and 9.76 to 9.84 on earth; gains and parameters that rest on "
     "weights have its error",
     "write 'gravity: [0, 0, -9.81]' in the robot file (in base axes; 'moon' and 'none' are words), or state "
     "'prior_gains' if it is right"),
    (Finding(F.PRIOR_GAIN, ("a",), values={"ratio": 0.001}),
     "the true torque is 0.001 times the logged one",
     "check the unit of the torques (N m, N mm?) and the payload's mass (kg), or state 'prior_gains'"),
    (Finding(F.HEAVY_PAYLOAD, (), "disc", {"mass": 2805.0, "reach": 1.7, "most": 481.6}),
     "payload 'disc' weighs 2805 kg, more than arms that reach 1.7 m carry (about 482 kg at most); all drive gains are "
     "proportional to it",
     "if it is in g, write 'mass: 2.805' (kg); otherwise state 'prior_gains'"),
    (Finding(F.UNLIKE_FILE, values={"factor": 998.0, "count": 14}),
     "the first moments of the links are 998 times those of the robot's file (rms of 14)",
     "check the payload's mass (kg), the unit of the torques, and the masses in the file; if the file is wrong, state "
     "'prior_gains'"),
    (Finding(F.NEGATIVE_PAYLOAD, (), "neg", {"mass": -5.0, "std": 0.03}),
     "its mass of -5 kg (standard deviation 0.03) is negative, which no body has",
     "check which runs carry it, as the others may be the loaded ones, the signs of the commands, and gravity"),
    (Finding(F.AUTOCORRELATED, values={"factor": 2.34}),
     "residuals are autocorrelated: standard errors are 2.3 times those of white noise, so the model lacks an effect, "
     "such as another kind of friction, motor ripple, cables or elasticity",
     ""),
    (Finding(F.IMPOSSIBLE_PARAMETERS, values={"parameters": [["fv_1", -1.0, 0.2, "N m s"]] * 4}),
     "physically impossible parameters: fv_1 = -1 N m s (standard deviation 0.2), fv_1 = -1 N m s (standard deviation "
     "0.2), fv_1 = -1 N m s (standard deviation 0.2) and 1 more",
     "check the signs of positions and currents, the sampling rate, the units and 'preparation'"),
    (Finding(F.NOT_SEPARATED, values={"parameters": ["mx_1", "my_1"]}),
     "these motions cannot separate mx_1, my_1 from the other base parameters: no value is given",
     "add runs with different motions of all joints"),
    (Finding(F.MASS_UNSEEN, (), "tip", values={"sums": ["mx - 0.04 m", "my - 0.1445 m"]}),
     "the mass of payload 'tip' is not identifiable, because only sums with its other parameters affect the joint "
     "torques: mx - 0.04 m, my - 0.1445 m",
     "if its centre of mass is known, write it as 'center: [x, y, z]' of the payload, m"),
    (Finding(F.MASS_UNSEEN, (), "tip", values={"sums": []}),
     "the mass of payload 'tip' is not identifiable, because it affects no joint torque: the body that carries it "
     "turns about a fixed point",
     "if its centre of mass is known, write it as 'center: [x, y, z]' of the payload, m"),
    (Finding(F.COMMAND_LAG, values={"kind": "current", "lag": 0.012, "std": 0.001, "bandwidth": 10.0}),
     "the currents lag behind the motion by 12 ms (standard deviation 1 ms), so they look low-passed, held or "
     "logged late; a low-pass filter with that time constant attenuates them by 20 % at the bandwidth of the motion, "
     "10 Hz",
     "log the currents before any filter and with the time stamps of the positions"),
    (Finding(F.SMOOTHED, values={"kind": "current", "end": 2.34, "nyquist": 250.0, "runs": ["a", "b"]}),
     "the currents of 'a' and 'b' were smoothed: above 2.3 Hz they hold nothing, not even noise, though their rate "
     "shows up to 250 Hz; what a filter takes from motion and friction is in no interval",
     "identify from the logs as they were recorded"),
    (Finding(F.SMOOTHED, values={"kind": "current", "window": 1.0, "runs": ["a"]}),
     "the currents of 'a' were smoothed by a moving average over 1 s; what a filter takes from motion and friction is "
     "in no interval", "identify from the logs as they were recorded"),
    (Finding(F.SLIGHT_COMMAND_LAG, values={"kind": "current", "lag": 0.02, "std": 0.001, "bandwidth": 10.0}),
     "the currents lag behind the motion by more than 16 ms, so they look low-passed, held or logged late; a low-pass "
     "filter with that time constant attenuates them by 38 % at the bandwidth of the motion, 10 Hz",
     "log the currents before any filter and with the time stamps of the positions"),
    (Finding(F.SCALE_UNTESTED, values={"joint": "left"}, causes=(Finding(F.SIGN_OPEN, values={"payload": True}),)),
     "the torques are assumed to be correct, because their scale could not be tested: that of no joint is identifiable "
     "('left': the 95 % interval includes zero)",
     "add runs with a heavier payload of known mass, or longer ones"),
]
# fmt: on


@pytest.mark.parametrize(("finding", "why", "to_do"), SENTENCES, ids=[str(each[0].kind) for each in SENTENCES])
def test_the_sentence_of_a_finding(finding: Finding, why: str, to_do: str) -> None:
    assert finding.what == why
    assert finding.action == to_do


def test_braces_in_names_stay_braces() -> None:
    said = Finding(F.NOT_SEPARATED, ("{joint}{",), values={"parameters": ["mx_{}"]}).what
    assert "cannot separate mx_{} from the other" in said


def test_every_kind_has_a_sentence() -> None:
    words = {kind for section in ("verdicts", "notes", "logs", "causes") for kind in templates()[section]}
    assert {finding.kind for finding, _, _ in SENTENCES} == words


@pytest.mark.parametrize("finding", [each[0] for each in SENTENCES], ids=lambda finding: str(finding.kind))
def test_findings_are_documents(finding: Finding) -> None:
    assert TypeAdapter(Finding).validate_json(json.dumps(finding_document(finding), allow_nan=False)) == replace(
        finding, time=None
    )


def test_measured_wrenches_come_first_in_the_advice() -> None:
    values = {"share": 0.3, "kind": "current", "given": False}
    alone = Finding(F.UNEXPLAINED, ("left",), values=values)
    beside = Finding(F.UNEXPLAINED, ("left",), values={**values, "wrenches": True})
    assert beside.action == f"{phrase('wrenches')}; otherwise {alone.action}"


def test_a_wrench_that_is_the_cause_is_all_that_is_to_be_checked() -> None:
    values = {"size": 1.0, "unit": "", "share": 0.6, "move": 0.1, "wrenches": True}
    cause = Finding("wrench points", (), "3", {"what": "the point", "action": "measure the position of the sensor"})
    assert Finding(F.REFUTED, ("left",), values=values, causes=(cause,)).action == "measure the position of the sensor"


def test_causes_of_one_effect_are_named_together() -> None:
    assert named_causes((ZERO, FALLING)) == f"{ZERO.what} or {FALLING.what}"


def test_a_finding_has_a_topic_and_its_sentence() -> None:
    lag = Finding("lag", ("left",), text="late", advice="log", grade=Grade.WARNING, shown_as="unit", source="run")
    assert (lag.topic, lag.joint, lag.severity) == (F.UNIT, "left", Severity.WARNING)
    assert str(lag) == "run: late; log"


def test_numbers_are_written_as_people_write_them() -> None:
    assert percents([65.142, 65.141]) == "65.14 %"
    assert percents([1.2, 65.14]) == "1.20 to 65.14 %"
    assert percents([3923.72, 12.0]) == "12.00 to more than 1000 %"
    assert filled("unexplained current", {"share": 37.0, "kind": "current", "given": True})[0].count("more than 1000 %")
    assert "a robot mass of 0 kg" in filled("negative mass", {"mass": -0.0})[0]
