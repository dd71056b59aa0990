"""Other libraries' filters on our looks."""

import jax
import jax.numpy as jnp
import numpy as np

from tests.oracles import kalman as oracle


def dynamax_smoother(peer, prior, looks, sigma_a):
    """Return dynamax's posterior; every look is seen.

    Its prior stands at the first look; weights lead from the look before, as ours do.
    """
    steps = np.diff([prior.time_s, *[look["time"] for look in looks]])
    first, noise = oracle.transition(steps[0]), oracle.acceleration_noise(steps[0], sigma_a)
    zero = jnp.zeros
    size = len(looks)
    stack = lambda make: jnp.asarray(np.stack([make(dt) for dt in steps]))
    h = [np.concatenate([np.eye(2), look["delay"] * np.eye(2)], axis=1) for look in looks]
    params = peer.ParamsLGSSM(
        initial=peer.ParamsLGSSMInitial(
            mean=jnp.asarray(first @ prior.mean),
            cov=jnp.asarray(first @ prior.covariance @ first.T + noise),
        ),
        dynamics=peer.ParamsLGSSMDynamics(
            weights=stack(oracle.transition),
            bias=zero((size, 4)),
            input_weights=zero((size, 4, 0)),
            cov=stack(lambda dt: oracle.acceleration_noise(dt, sigma_a)),
        ),
        emissions=peer.ParamsLGSSMEmissions(
            weights=jnp.asarray(np.stack(h)),
            bias=zero((size, 2)),
            input_weights=zero((size, 2, 0)),
            cov=jnp.asarray(np.stack([look["R"] for look in looks])),
        ),
    )
    z = jnp.asarray(np.stack([look["z"] for look in looks]))
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        return peer.lgssm_smoother(params, z)
