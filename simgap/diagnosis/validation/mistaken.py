"""How often each effect is found on machines that lack it.

Laws that scale what a simulator has already (gains, scales of sensors, the length of a row) take the place of much that
is missing; others, such as a rate limit, of hardly anything.
"""

import numpy as np

USUAL = 1.94
"""Wrong findings of an effect per hundred machines drawn at random: of all effects on average."""
PER_HUNDRED = {
    "arm_base_coupling": 1.3, "asymmetric_gain": 6.9, "backlash": 0.32, "body_frame_bias": 2.2, "centripetal": 1.3,
    "coulomb_friction": 2.6, "cross_axis_coupling": 1.2, "deadband": 1.0, "delay": 2.4, "external_push": 1.3,
    "gain": 4.7, "gain_drift": 1.6, "gravity_sag": 1.3, "hysteresis": 1.7, "integration_rule": 3.1,
    "joint_gravity": 3.2, "lag": 1.5, "load_friction": 1.1, "nonlinear_spring": 2.3, "quadratic_drag": 0.64,
    "quantization": 0.32, "rate_limit": 0.26, "rectified_sensor": 0.87, "relative_smoothing": 1.9, "resonance": 0.87,
    "rotation_centre": 0.88, "sampling_interval": 1.1, "saturation": 0.77, "sensor_bias": 2.0, "sensor_delay": 2.2,
    "sensor_scale": 4.0, "slip": 1.3, "stribeck_friction": 0.62, "viscous_drag": 1.6,
}  # fmt: skip
"""The same of each effect that those machines may have, from reports/ground/calibration.json."""


def mistaken(effect: str) -> float:
    """ln of the wrong findings per hundred machines; the usual one for an effect without experience."""
    return float(np.log(PER_HUNDRED.get(effect, USUAL)))
