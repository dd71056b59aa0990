"""Studies from files: cores, the cost of a trial as studies grow, memory, a million trials.

Every run is a process of its own, on as many cores as it says, which are its devices; the first
chunk, which compiles, is not timed. And how long the import takes. `make bench`, or with names:
`python benchmarks/studies.py cores cost`. The figure goes to results/benchmarks.
"""

import json
import os
import pathlib
import resource
import subprocess
import sys
import tempfile
import time

CORES = sorted(os.sched_getaffinity(0))
ROOT = pathlib.Path(__file__).resolve().parents[1]
FIGURE = ROOT / "results" / "benchmarks" / "cost_of_a_trial.png"
# The cell P_M = P_F = 0.3, σ = 3 m of the study csht_estimation, false alarms by beam.
CSHT = """
trials = {trials}
chunk = 500
micro_batch = 1
[scene]
function = "jaxtrack.studies.csht.trial:window"
[method.CSHT]
function = "jaxtrack.studies.csht.trial:csht"
[metric.position_ospa_m]
function = "jaxtrack.studies.csht.trial:position_ospa_m"
"""
# As little as there can be in a trial: what is left is the engine and the store.
CHEAP = """
trials = {trials}
chunk = 250
micro_batch = 50
[scene]
function = "jax.random:normal"
[method.size]
function = "jax.numpy:abs"
[metric.negative]
function = "operator:lt"
"""
STUDIES = {"csht": CSHT, "cheap": CHEAP}
MILLION = 1_000_000


def run(name, trials):
    """Run a study on the cores of this process, and print what it took."""
    import jax

    jax.config.update("jax_num_cpu_devices", len(CORES))
    from jaxtrack.studies.design import design_of
    from jaxtrack.studies.run import run_study

    design = design_of(STUDIES[name].format(trials=trials), ROOT)
    begin, compiled = time.perf_counter(), None

    def see(progress):
        nonlocal compiled
        if compiled is None and progress.done >= design.chunk:
            compiled = time.perf_counter()

    with tempfile.TemporaryDirectory() as folder:
        assert run_study(design, pathlib.Path(folder), on_progress=see).complete
    rest = time.perf_counter() - compiled
    took = {
        "first_s": compiled - begin,
        "trial_s": rest / (trials - design.chunk),
        "mib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }
    print(json.dumps(took))


def measured(name, trials, cores):
    """Return what a study took in a process of its own, on some cores."""
    command = [sys.executable, __file__, "run", name, str(trials)]
    done = subprocess.run(
        command,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        preexec_fn=lambda: os.sched_setaffinity(0, cores),
        capture_output=True,
        text=True,
    )
    if done.returncode:
        raise SystemExit(done.stderr)
    return json.loads(done.stdout)


def cores():
    trials = 4000
    print(f"\n{trials} trials of csht_estimation's cell P_M = P_F = 0.3, σ = 3 m, CSHT alone")
    one = measured("csht", trials, CORES[:1])
    all_ = measured("csht", trials, CORES)
    for name, took in (("one pinned core", one), (f"{len(CORES)} cores", all_)):
        print(
            f"{name:16} {1 / took['trial_s']:7.0f} trials a second, "
            f"first chunk {took['first_s']:5.1f} s, {took['mib']:5.0f} MiB"
        )
    print(f"ratio {one['trial_s'] / all_['trial_s']:.2f}, aim 1.7", flush=True)


def million():
    trials = 100_000
    took = measured("csht", trials, CORES)
    hours = (took["first_s"] + MILLION * took["trial_s"]) / 3600
    print(
        f"\na million trials of that cell on {len(CORES)} cores: {hours:.2f} hours, aim 1; "
        f"from {trials} trials at {1 / took['trial_s']:.0f} a second after the first chunk "
        f"({took['first_s']:.0f} s), {took['mib']:.0f} MiB",
        flush=True,
    )


def cost():
    from matplotlib.figure import Figure

    print("\na study with next to nothing in a trial: the engine and the store")
    sizes = [1000, 3000, 10_000, 30_000, 100_000, 300_000, MILLION]
    took = []
    for trials in sizes:
        took.append(measured("cheap", trials, CORES))
        print(
            f"{trials:8d} trials {took[-1]['trial_s'] * 1e6:7.1f} µs a trial, "
            f"{took[-1]['mib']:5.0f} MiB",
            flush=True,
        )
    figure = Figure(figsize=(7, 3), layout="constrained")
    for place, (name, label, scale) in enumerate(
        (("trial_s", "µs a trial", 1e6), ("mib", "largest memory, MiB", 1.0)), start=1
    ):
        axes = figure.add_subplot(1, 2, place)
        axes.semilogx(sizes, [one[name] * scale for one in took], "o-")
        top = 1.2 * scale * max(one[name] for one in took)
        axes.set(xlabel="trials", ylabel=label, ylim=(0, top))
        axes.grid(alpha=0.3)
    FIGURE.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(FIGURE, dpi=120)
    print(FIGURE.relative_to(ROOT))


def imports():
    code = "import time, jax; begin = time.perf_counter(); import jaxtrack; "
    code += "print(time.perf_counter() - begin)"
    env = {**os.environ, "PYTHONPATH": str(ROOT)}
    once = lambda: float(subprocess.check_output([sys.executable, "-c", code], env=env, text=True))
    more = min(once() for _ in range(10))
    print(f"\nimport jaxtrack after import jax: {1000 * more:.0f} ms, aim 150", flush=True)


PARTS = {"imports": imports, "cores": cores, "cost": cost, "million": million}


def main(names):
    if names[:1] == ["run"]:
        run(names[1], int(names[2]))
        return
    print(f"load of the machine before: {os.getloadavg()[0]:.1f} on {len(CORES)} cores")
    for name, part in PARTS.items():
        if not names or name in names:
            part()


if __name__ == "__main__":
    main(sys.argv[1:])
