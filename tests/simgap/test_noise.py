"""Densities against scipy's."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from simgap.noise import FAMILIES, gaussian_log_density, student_t_log_density

R = np.linspace(-6, 6, 25)


def test_gaussian_density() -> None:
    np.testing.assert_allclose(
        gaussian_log_density(jnp.asarray(R), jnp.array(0.7)), stats.norm.logpdf(R, scale=0.7), rtol=1e-5
    )


@pytest.mark.parametrize("dof", [1.1, 3.0, 40.0])
def test_student_t_density(dof: float) -> None:
    ours = student_t_log_density(jnp.asarray(R), jnp.array(0.7), jnp.array(dof))
    np.testing.assert_allclose(ours, stats.t.logpdf(R, dof, scale=0.7), rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("name", FAMILIES)
def test_families_read_back_what_they_start_with(name: str) -> None:
    family = FAMILIES[name]
    noise = family.init(3)
    np.testing.assert_allclose(family.scale(noise), 0.2, rtol=1e-6)
    assert (family.dof(noise) > 1).all()
    assert family.log_density(noise, jnp.zeros((5, 3))).shape == (5, 3)


@pytest.mark.parametrize("name", FAMILIES)
def test_training_begins_with_numbers_of_the_type_that_it_ends_with(name: str) -> None:
    """Otherwise it is compiled anew after its first steps."""
    assert not any(value.weak_type for value in FAMILIES[name].init(3).values())
