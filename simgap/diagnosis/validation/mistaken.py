"""How often each effect is found on machines that lack it.

Laws that scale what a simulator has already (gains, scales of sensors, the length of a row) take the place of much that
is missing; others, such as a rate limit, of hardly anything.
"""

import numpy as np

USUAL = 1.93
"""Wrong findings of an effect per hundred machines drawn at random: of all effects on average."""
PER_HUNDRED = {
    "asymmetric_gain": 6.8, "backlash": 0.33, "body_frame_bias": 2.2, "coulomb_friction": 2.5,
    "cross_axis_coupling": 1.0, "deadband": 0.73, "delay": 2.5, "external_push": 1.2, "gain": 4.1, "gain_drift": 1.6,
    "hysteresis": 1.7, "integration_rule": 3.3, "joint_gravity": 3.2, "lag": 1.5, "load_friction": 1.1,
    "nonlinear_spring": 2.3, "quadratic_drag": 0.60, "quantization": 0.33, "rate_limit": 0.27,
    "rectified_sensor": 0.99, "resonance": 0.99, "rotation_centre": 1.0, "sampling_interval": 1.1, "saturation": 0.80,
    "sensor_bias": 2.1, "sensor_delay": 2.3, "sensor_scale": 4.1, "stribeck_friction": 0.62, "viscous_drag": 1.6,
}  # fmt: skip
"""The same of each effect that those machines may have, from reports/ground/calibration.json."""


def mistaken(effect: str) -> float:
    """ln of the wrong findings per hundred machines; the usual one for an effect without experience."""
    return float(np.log(PER_HUNDRED.get(effect, USUAL)))
