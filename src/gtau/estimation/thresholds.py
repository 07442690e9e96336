"""Every tuned constant that decides an outcome."""

MISFIT = 0.25  # share of a joint's current that the model leaves unexplained
ALONE = 0.6  # residual of a joint fitted by its own equations over that with all joints
APART = 3.5  # standard deviations between two estimates of one number
DRIFT = 0.005  # change of a joint's current along a run, or from run to run, as a share of it
DRIFTING = 6.0  # standard deviations of that change
SCALED = 0.3  # change of the current in a run that no motor makes
DOMINANT = 0.3  # share of the residual variance of all joints explained by currents out of scale in some runs
LACKING = (
    1.3  # standard deviations by the jackknife over those of independent residuals, from which reasons are looked for
)
INFLATED = 1.5  # the same, from which users are told
WEAK_GAIN = 0.03  # relative standard deviation of a gain
LOST_GAIN = 0.5  # relative standard deviation of a gain
WEAK_PARAMETER = 0.2  # relative standard deviation of a parameter
SATURATION_STD = 10.0  # standard deviations of the fall of a torque constant with the current
SATURATION_SHARE = 0.1  # share of the residual variance that it explains
RIPPLE_SHARE = 0.3  # share of a joint's residual variance that repeats at the same positions
GRAVITY_SHARE = 0.3  # share of the residual variance explained by another gravity
LENGTH_SHARE = 0.1  # share of the residual variance explained by other lengths
LENGTH_CHANGE = 0.005  # relative change of that length
SWAPPED = 0.5  # residual with the other joint's current over that with its own
PRIOR_FACTOR = 2.0  # gain over its prior
EFFORT_FACTOR = 2.0  # rms torque over the joint's limit of effort
PAYLOAD_MOVES = 0.01  # relative move of a gain when a known parameter of a payload is estimated
LEG_PROBABILITY = 0.001  # probability that legs which are alike differ by as much
LEG_DIFFERENCE = 20.0  # difference of a parameter between like legs, per cent
LEG_DIFFERENCE_STD = 5.0  # the same in standard deviations
DELAY_MOTION = 4.0  # standard errors of the share of motion in the current's rate of change
FRICTION_TERM_GAIN = 0.02  # share of a joint's residual that a friction term takes away
FRICTION_TERM_STD = 1 / 3  # relative standard deviation of a friction term
CLOCK_SHARE = 0.6  # share of the residual variance that another clock explains (UR10e at 95 Hz read as 125: 0.62)
CLOCK_SIZE = 0.9  # part of the variance explained by another gravity that another size of it explains alone
CLOCK_REVERSED = -0.9  # factor of gravity by a linear estimate, below which it is rather reversed than of another size
UNFELT_PAYLOAD = 1.1  # residual of the currents without the payload over that with it (UR10e: targets 1.03, actual 16)
