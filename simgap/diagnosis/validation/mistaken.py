"""How often each effect is found on machines that lack it.

Laws that scale what a simulator has already (gains, scales of sensors, the length of a row) take the place of much that
is missing; others, such as a rate limit, of hardly anything.
"""

import numpy as np

USUAL = 1.95
"""Wrong findings of an effect per hundred machines drawn at random: of all effects on average."""
PER_HUNDRED = {
    "arm_base_coupling": 1.3, "asymmetric_gain": 6.8, "backlash": 0.31, "body_frame_bias": 2.3,
    "centripetal": 1.3, "coulomb_friction": 2.5, "cross_axis_coupling": 1.6, "deadband": 1.1, "delay": 2.4,
    "external_push": 1.3, "gain": 4.6, "gain_drift": 1.6, "gravity_sag": 1.3, "hysteresis": 1.6,
    "integration_rule": 3.2, "joint_gravity": 3.9, "lag": 1.5, "load_friction": 1.0, "nonlinear_spring": 2.4,
    "quadratic_drag": 0.75, "quantization": 0.31, "rate_limit": 0.25, "rectified_sensor": 0.98,
    "relative_smoothing": 1.9, "resonance": 0.78, "rotation_centre": 1.1, "sampling_interval": 1.1,
    "saturation": 0.81, "sensor_bias": 2.0, "sensor_delay": 2.2, "sensor_scale": 4.0, "slip": 1.7,
    "stribeck_friction": 0.60, "viscous_drag": 1.9,
}  # fmt: skip
"""The same of each effect that those machines may have, from reports/ground/calibration.json."""


def mistaken(effect: str) -> float:
    """ln of the wrong findings per hundred machines; the usual one for an effect without experience."""
    return float(np.log(PER_HUNDRED.get(effect, USUAL)))
