"""The particle filter: bias of every resampler's gradient, and speed beside cuthbert.

The model is linear and Gaussian, so that the Kalman filter gives the exact log-likelihood and its
exact gradient. The table of bias is the one in docs/design.md. Everything is in double precision.
`make bench` has the speed; the table takes a minute and a half:
`python benchmarks/particle.py bias`.
"""

import functools
import pathlib
import sys
import time

import jax

jax.config.update("jax_enable_x64", True)
sys.path.append(str(pathlib.Path(__file__).parents[1]))  # for the model and the peer of the tests

import cuthbert  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402

from jaxtrack.filtering.resampling import (  # noqa: E402
    multinomial,
    residual,
    soft,
    stop_gradient,
    stratified,
    systematic,
)
from jaxtrack.filtering.transport import optimal_transport  # noqa: E402
from tests.filtering.linear_gaussian import MODEL, Model, kalman_run, looks, run  # noqa: E402
from tests.filtering.peers import cuthbert_particle_filter  # noqa: E402

SEED, LENGTH = 0, 50
# name, resampler, particles, runs, with the density of the motion
WAYS = (
    ("systematic", systematic, 400, 1000, False),
    ("stratified", stratified, 400, 1000, False),
    ("multinomial", multinomial, 400, 1000, False),
    ("residual", residual, 400, 1000, False),
    ("soft, α = .5", soft(systematic, 0.5), 100, 1000, False),
    ("soft, α = .1", soft(systematic, 0.1), 100, 1000, False),
    ("optimal transport, ε = .5", optimal_transport(0.5), 50, 200, False),
    ("optimal transport, ε = .1", optimal_transport(0.1), 50, 200, False),
    ("stop-gradient, through the states", stop_gradient(systematic), 400, 1000, False),
    ("stop-gradient", stop_gradient(systematic), 100, 1000, True),
    ("stop-gradient", stop_gradient(systematic), 400, 1000, True),
    ("stop-gradient", stop_gradient(systematic), 1600, 1000, True),
    ("stop-gradient, multinomial", stop_gradient(multinomial), 400, 1000, True),
)


def bias():
    """Print mean ± standard error of estimates less the exact ones."""
    z = jnp.asarray(looks(SEED, LENGTH))
    model = Model(*map(jnp.asarray, MODEL))
    value, gradient = jax.value_and_grad(lambda m: kalman_run(m, z)[2])(model)
    print(
        f"\nbias of log-likelihood and gradient, T = {LENGTH}, φ = {MODEL.phi}, q = "
        f"{MODEL.process_sigma}, r = {MODEL.noise_sigma}\nexact: {value:.2f}, "
        f"d/dφ {gradient.phi:.2f}, d/dq {gradient.process_sigma:.2f}, "
        f"d/dr {gradient.noise_sigma:.2f}\n"
        f"| resampling | N | runs | log-likelihood | d/dφ | d/dq | d/dr | sd a run, d/dφ |\n"
        f"|---|---|---|---|---|---|---|---|"
    )
    for name, resampler, size, runs, scored in WAYS:

        def one(key, resampler=resampler, size=size, scored=scored):
            def loss(at):
                return run(at, z, key, resampler, particles=size, scored=scored)[0].log_likelihood

            found, slope = jax.value_and_grad(loss)(model)
            return jnp.stack(
                [found - value, *(a - b for a, b in zip(slope, gradient, strict=True))]
            )

        keys = jax.random.split(jax.random.key(SEED), runs)
        error = np.asarray(jax.jit(lambda k, one=one: jax.lax.map(one, k, batch_size=4))(keys))
        mean, deviation = error.mean(0), error.std(0, ddof=1)
        cells = " | ".join(
            f"{m:+.2f} ± {d / runs**0.5:.2f}" for m, d in zip(mean, deviation, strict=True)
        )
        print(f"| {name} | {size} | {runs} | {cells} | {deviation[1]:.1f} |", flush=True)


def seconds(call, repeats=5):
    """Return seconds to compile, and seconds of the fastest of some calls."""
    times = []
    for _ in range(repeats + 1):
        begin = time.perf_counter()
        jax.block_until_ready(call())
        times.append(time.perf_counter() - begin)
    return max(times[0] - min(times[1:]), 0.0), min(times[1:])


def speed():
    """Print times of log-likelihood and gradient, ours and cuthbert's, one run and a batch."""
    z = jnp.asarray(looks(SEED, LENGTH))
    model = Model(*map(jnp.asarray, MODEL))
    ways = {
        "jaxtrack": lambda m, key, size: run(m, z, key, particles=size, scored=False)[0][3],
        "cuthbert": lambda m, key, size: cuthbert_particle_filter(cuthbert, m, z, key, size),
    }
    print(
        f"\nlog-likelihood of {LENGTH} looks, systematic stop-gradient resampling below 2N/3\n"
        f"{'N':>6}{'batch':>7}{'':>10}{'compile s':>11}{'us a look':>11}{'gradient':>10}"
        f"{'ratio':>7}  {'log-likelihood less the exact':>30}"
    )
    exact = float(kalman_run(model, z)[2])
    for size, batch in ((120, 256), (1600, 64)):
        keys = jax.random.split(jax.random.key(SEED), batch)
        for name, one in ways.items():
            loss = functools.partial(one, size=size)
            forward = jax.jit(jax.vmap(loss, (None, 0)))
            slope = jax.jit(jax.vmap(jax.grad(loss), (None, 0)))
            compile_s, run_s = seconds(lambda f=forward, k=keys: f(model, k))
            slope_s = seconds(lambda f=slope, k=keys: f(model, k))[1]
            apart = np.asarray(forward(model, keys)) - exact
            scale = 1e6 / batch / LENGTH
            print(
                f"{size:6}{batch:7}{name:>10}{compile_s:11.1f}{run_s * scale:11.2f}"
                f"{slope_s * scale:10.2f}{slope_s / run_s:7.1f}  "
                f"{apart.mean():+22.3f} ± {apart.std() / batch**0.5:.3f}",
                flush=True,
            )


PARTS = {"bias": bias, "speed": speed}


def main(names):
    print(f"jax {jax.__version__}, seed {SEED}")
    for name, part in PARTS.items():
        if not names or name in names:
            part()


if __name__ == "__main__":
    main(sys.argv[1:])
