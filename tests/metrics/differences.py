"""Central finite differences, to hold jitted gradients against."""

import jax
import jax.numpy as jnp
import numpy as np


def assert_gradients_agree(loss, *arguments, step=1e-5, rtol=1e-6, atol=1e-9):
    """Compare `jit(grad(loss))` with central differences, entry by entry, in every argument.

    Returns the gradients.
    """
    arguments = [np.asarray(argument, np.float64) for argument in arguments]
    everywhere = tuple(range(len(arguments)))
    gradients = jax.jit(jax.grad(loss, argnums=everywhere))(*map(jnp.asarray, arguments))
    value = jax.jit(loss)
    for place, argument in enumerate(arguments):
        expected = np.zeros_like(argument)
        for index in np.ndindex(argument.shape):
            ends = []
            for sign in (1.0, -1.0):
                moved = argument.copy()
                moved[index] += sign * step
                shifted = [*arguments[:place], moved, *arguments[place + 1 :]]
                ends.append(float(value(*map(jnp.asarray, shifted))))
            expected[index] = (ends[0] - ends[1]) / (2 * step)
        np.testing.assert_allclose(gradients[place], expected, rtol=rtol, atol=atol)
    return gradients
