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


def cuthbert_particle_filter(cuthbert, model, z, key, size):
    """Return cuthbert's log-likelihood of a `linear_gaussian` model, resampled as ours."""
    from cuthbert.smc import particle_filter as smc
    from cuthbertlib.resampling import systematic
    from cuthbertlib.resampling.adaptive import ess_decorator
    from cuthbertlib.resampling.autodiff import stop_gradient_decorator

    def density(x, z):
        error = (z - x[0]) / model.noise_sigma
        return -(error**2) / 2 - jnp.log(model.noise_sigma * jnp.sqrt(2 * jnp.pi))

    engine = smc.build_filter(
        lambda key: jax.random.normal(key, (1,), z.dtype),
        lambda key, x, z: (
            model.phi * x + model.process_sigma * jax.random.normal(key, (1,), x.dtype)
        ),
        lambda before, x, z: density(x, z),
        size,
        ess_decorator(stop_gradient_decorator(systematic.resampling), 2 / 3),
    )
    begin, rest = jax.random.split(key)
    found = cuthbert.filter(engine, z, engine.init_prepare(key=begin), key=rest)
    return found.log_normalizing_constant[-1]
