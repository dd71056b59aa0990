"""Studies in several processes: the bytes of one, whoever dies, fails or is interrupted."""

import os
import random
import shutil
import signal
import socket
import subprocess
import sys
import time

import pytest

from jaxtrack.studies import chunk_store, chunks
from jaxtrack.studies.design import read_design
from jaxtrack.studies.hold import held
from jaxtrack.studies.run import run_study, status_of
from jaxtrack.studies.study_file import StudyError
from tests.studies.own_study import (
    FILE,
    bytes_in,
    environment,
    results_in,
    write_documented,
    written,
)

# Says which chunks it writes. Its trouble: the disk is full at the third, or the first has to wait.
CHILD = """
import errno, os, pathlib, sys
import jax

file, out, address, index, heartbeat_s, trouble = sys.argv[1:]
jax.distributed.initialize(address, 2, int(index), heartbeat_timeout_seconds=int(heartbeat_s))

from jaxtrack.studies import chunks, run
from jaxtrack.studies.design import read_design

inner, written = chunks.write, []

def write(store, number, values):
    written.append(number)
    print(number, flush=True)
    if trouble == "waits" and len(written) == 1:
        input()
    if trouble == "full disk" and len(written) == 3:
        def full(handle):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        os.fsync = full
    inner(store, number, values)

chunks.write = write
run.run_study(read_design(pathlib.Path(file)), pathlib.Path(out))
"""


PIPES = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE) | {"text": True}


def free_port():
    with socket.socket() as probe:
        probe.bind(("", 0))
        return probe.getsockname()[1]


def two(file, out, *, devices=(1, 2), heartbeat_s=100, trouble=("", "")):
    """Start two processes of one run."""
    address, pair = f"localhost:{free_port()}", []
    for index in (0, 1):
        arguments = (file, out, address, index, heartbeat_s, trouble[index])
        command = [sys.executable, "-c", CHILD, *map(str, arguments)]
        pair.append(subprocess.Popen(command, env=environment(devices[index]), **PIPES))
    return pair


def ended(pair):
    """Return exit codes, the numbers of chunks that were written, and what was complained of."""
    told = [process.communicate() for process in pair]
    numbers = [[int(line) for line in out.split()] for out, _ in told]
    return [process.returncode for process in pair], numbers, [err for _, err in told]


@pytest.fixture(scope="module")
def long(tmp_path_factory):
    """Return a study of many chunks, and where one process has run it."""
    folder = tmp_path_factory.mktemp("long")
    file = written(folder, FILE.replace("trials = 40", "trials = 480"))
    assert run_study(read_design(file), folder / "one").complete
    return file, folder / "one"


def test_two_processes_stop_where_one_does_and_write_its_bytes(tmp_path, long):
    file = written(tmp_path, f"until = {{ metric = 'error_m', se = 0.2 }}\n{FILE}")
    file.write_text(file.read_text().replace("trials = 40", "trials = 480"))
    design = read_design(file)
    alone = run_study(design, tmp_path / "one")
    assert 40 < alone.found.trials < 440
    pair = two(file, tmp_path / "two")
    codes, numbers, complaints = ended(pair)
    assert codes == [0, 0], complaints
    first, second = map(set, numbers)
    assert first
    assert second
    assert not first & second
    assert first | second >= set(range(alone.found.trials // 8))
    assert results_in(tmp_path / "two") == results_in(tmp_path / "one")


def test_chunks_beyond_the_end_are_removed(tmp_path, long):
    file, whole = long
    design = read_design(file)
    wide = run_study(design, tmp_path / "wide", stopped=lambda: True)
    assert wide.found.trials == 8
    # A process was ahead when the others died: chunk 2 is there, chunk 1 is not.
    values = chunks.read(chunk_store.open_chunks(whole), 2)
    chunks.write(wide.store, 2, values)
    assert status_of(tmp_path / "wide").found.trials == 8
    assert run_study(design, tmp_path / "wide").complete
    assert results_in(tmp_path / "wide") == results_in(whole)
    # The same, but beyond the end that the rule sets.
    until = written(tmp_path, f"until = {{ metric = 'error_m', se = 0.6 }}\n{FILE}")
    stopped = run_study(read_design(until), tmp_path / "early")
    before, end = results_in(tmp_path / "early"), stopped.found.trials // 8
    assert end < 4
    chunks.write(stopped.store, 4, values)
    assert run_study(read_design(until), tmp_path / "early").complete
    assert results_in(tmp_path / "early") == before


def killed_and_resumed(tmp_path, kills, seed):
    """Return the bytes of a study of which both processes were killed so often, and of a whole."""
    trials = 8 * 40 * (kills + 1)
    file = written(tmp_path, FILE.replace("trials = 40", f"trials = {trials}"))
    design, out = read_design(file), tmp_path / "out"
    draw = random.Random(seed)
    for turn in range(kills):
        devices = ((1, 2), (4, 1), (2, 2))[turn % 3]
        pair = two(file, out, devices=devices, trouble=("waits", "waits"))
        for process in pair:
            assert process.stdout.readline()  # its first chunk is computed
        for process in pair:
            print(file=process.stdin, flush=True)
        time.sleep(0.1 * draw.random())
        dies, stays = draw.sample(pair, 2)
        dies.kill()
        time.sleep(0.1 * draw.random())
        stays.kill()
        ended(pair)
        assert dies.returncode == -signal.SIGKILL
        assert status_of(out).damaged == ()
        assert not status_of(out).complete
    assert run_study(design, out).complete
    assert run_study(design, tmp_path / "whole").complete
    return results_in(out), results_in(tmp_path / "whole")


def test_a_study_killed_in_two_processes_ends_in_the_same_bytes(tmp_path):
    resumed, whole = killed_and_resumed(tmp_path, 3, seed=0)
    assert resumed == whole


@pytest.mark.slow
def test_a_study_killed_twenty_times_in_two_processes_ends_in_the_same_bytes(tmp_path):
    resumed, whole = killed_and_resumed(tmp_path, 20, seed=1)
    assert resumed == whole


@pytest.mark.slow
def test_a_full_disk_of_one_process_ends_both_and_loses_nothing(tmp_path, long):
    file, whole = long
    out = tmp_path / "out"
    pair = two(file, out, trouble=("waits", "full disk"))  # else the first might do all
    *stored, failed = (int(pair[1].stdout.readline()) for _ in range(3))
    print(file=pair[0].stdin, flush=True)
    codes, numbers, complaints = ended(pair)
    assert codes == [1, 1]
    span = f"trials {8 * failed} to {8 * failed + 7}"
    reason = f"StudyError: {out}: {span} could not be written: No space left on device"
    assert reason in complaints[1]
    assert f"process 1 ended: {reason.partition(' ')[2]}" in complaints[0]
    assert chunks.committed(chunk_store.open_chunks(out)) == {*numbers[0], *stored}
    assert run_study(read_design(file), out).complete
    assert results_in(out) == results_in(whole)


@pytest.mark.slow
def test_what_is_damaged_is_computed_again_by_two_processes(tmp_path, long):
    file, whole = long
    out = tmp_path / "out"
    shutil.copytree(whole, out)
    array = out / chunks.RESULTS / "mean.error_m" / "c" / "0"
    for number in (0, 7, 8, 59):
        (array / str(number)).write_bytes((array / str(number)).read_bytes()[:-3])
    codes, numbers, complaints = ended(two(file, out))
    assert codes == [0, 0], complaints
    assert sorted(numbers[0] + numbers[1]) == [0, 7, 8, 59]
    assert results_in(out) == results_in(whole)


@pytest.mark.slow
def test_two_processes_make_a_study_longer(tmp_path, long):
    file, whole = long
    out = tmp_path / "out"
    short = written(tmp_path, FILE.replace("trials = 40", "trials = 204"))
    assert run_study(read_design(short), out).complete
    codes, numbers, complaints = ended(two(file, out))
    assert codes == [0, 0], complaints
    assert sorted(numbers[0] + numbers[1]) == list(range(25, 60))
    assert results_in(out) == results_in(whole)


@pytest.mark.slow
def test_a_store_of_another_version_is_refused_in_both(tmp_path, long):
    file, whole = long
    out = tmp_path / "out"
    shutil.copytree(whole, out)
    meta = out / chunks.RESULTS / "zarr.json"
    meta.write_text(meta.read_text().replace('"format": 2', '"format": 9'))
    before = bytes_in(out)
    codes, numbers, complaints = ended(two(file, out))
    assert (codes, numbers) == ([1, 1], [[], []])
    reason = "the store has format 9, this version of jaxtrack reads 2"
    assert f"StudyError: {out}: {reason}" in complaints[0]
    assert f"StudyError: process 0 ended: {out}: {reason}" in complaints[1]
    assert bytes_in(out) == before


@pytest.mark.slow
@pytest.mark.parametrize("dies", [0, 1])
def test_who_is_left_alone_ends_too_and_until_then_holds_the_folder(tmp_path, long, dies):
    file, whole = long
    design, out = read_design(file), tmp_path / "out"
    pair = two(file, out, heartbeat_s=10)
    assert pair[dies].stdout.readline()
    pair[dies].kill()
    pair[dies].wait()
    if dies == 1:  # without process 0 the other one ends at once
        with pytest.raises(StudyError, match="another run is at work there"):
            run_study(design, out)
    pair[1 - dies].wait(timeout=60)
    codes, _, _ = ended(pair)
    assert codes[dies] == -signal.SIGKILL
    assert codes[1 - dies] == -signal.SIGABRT
    assert status_of(out).damaged == ()
    assert run_study(design, out).complete
    assert results_in(out) == results_in(whole)


@pytest.fixture
def documented(tmp_path):
    """Return a folder with the documentation's files, and an environment in which they run."""
    write_documented(tmp_path)
    commands = {
        "jaxtrack": f'exec "{sys.executable}" -m jaxtrack.cli "$@"',
        # Another machine is another shell.
        "ssh": 'while [[ $1 == -* ]]; do shift; done; shift; exec bash -c "$*"',
        "srun": """
            while [[ $1 == -* ]]; do shift; done
            export SLURM_STEP_NUM_TASKS=$SLURM_NTASKS SLURM_STEP_NODELIST=localhost
            for ((i = 0; i < SLURM_NTASKS; i++)); do
                SLURM_PROCID=$i SLURM_LOCALID=$i "$@" & processes+=($!)
            done
            for process in "${processes[@]}"; do wait "$process" || exit; done
            """,
    }
    (tmp_path / "bin").mkdir()
    for name, text in commands.items():
        (tmp_path / "bin" / name).write_text(f"#!/bin/bash\n{text}\n")
        (tmp_path / "bin" / name).chmod(0o755)
    path = f"{tmp_path / 'bin'}{os.pathsep}{os.environ['PATH']}"
    return tmp_path, {**environment(2), "PATH": path}


def check_recipe(folder, script, env):
    """Check that a script of the documentation gives the bytes and the table of one process."""
    settings = {"cwd": folder, "env": env, "capture_output": True, "text": True}
    run = subprocess.run(["bash", script], **settings)
    assert run.returncode == 0, run.stderr
    command = [folder / "bin" / "jaxtrack", "study", "run", "middles.toml", "--out", "one"]
    one = subprocess.run(command, **settings)
    assert bytes_in(folder / "results" / "middles") == bytes_in(folder / "one")
    assert run.stdout == one.stdout.replace("one: ", "results/middles: ", 1)
    assert run.stdout.endswith("\ncomplete\n")


def test_the_recipe_for_ssh_is_true(documented):
    folder, env = documented
    script = folder / "over_ssh.sh"
    text = script.read_text()
    for told, here in (("(node1 node2)", "(localhost localhost)"), (":7788", f":{free_port()}")):
        assert told in text
        text = text.replace(told, here)
    script.write_text(text)
    check_recipe(folder, script, env)


@pytest.mark.slow
def test_the_recipe_for_slurm_is_true(documented):
    folder, env = documented
    # JAX takes one of 4096 ports, by the number of the job.
    slurm = {"JOB_ID": random.randrange(4096), "NTASKS": 2, "CPUS_PER_TASK": 2}
    env |= {f"SLURM_{name}": str(value) for name, value in slurm.items()}
    check_recipe(folder, folder / "on_slurm.sh", env)


@pytest.mark.slow
def test_an_interrupt_of_one_process_ends_both_and_both_go_on(tmp_path):
    file = written(tmp_path, FILE.replace("trials = 40", "trials = 1200"))
    out = tmp_path / "out"

    def pair(action, target, *options):
        address = f"localhost:{free_port()}"
        command = [sys.executable, "-m", "jaxtrack.cli", "study", action, str(target), *options]
        command += ["--coordinator-address", address, "--num-processes", "2", "--process-id"]
        return [subprocess.Popen([*command, str(n)], env=environment(1), **PIPES) for n in (0, 1)]

    begun = pair("run", file, "--out", str(out))
    while not list((out / chunks.COMMITS).glob("*.json")):
        time.sleep(0.01)
    begun[1].send_signal(signal.SIGINT)
    (said, _), (other, asked) = (process.communicate() for process in begun)
    assert [process.returncode for process in begun] == [130, 130]
    assert said.splitlines()[-1] == f"to go on: jaxtrack study resume {out}"
    assert other == ""
    assert "ends after this chunk" in asked
    status = status_of(out)
    assert said.splitlines()[0] == f"{out}: {status.found.trials} of 1200 trials"
    assert len(chunks.committed(status.store)) == status.found.trials // 8
    done = pair("resume", out)
    (said, _), (other, complaint) = (process.communicate() for process in done)
    assert [process.returncode for process in done] == [0, 0], complaint
    assert (said.splitlines()[-1], other) == ("complete", "")
    assert run_study(read_design(file), tmp_path / "one").complete
    assert results_in(out) == results_in(tmp_path / "one")


def test_a_folder_is_held_by_one_run_and_let_go_by_a_dead_process(long):
    _, whole = long
    refused = pytest.raises(StudyError, match="another run is at work there")
    with held(whole, alone=False), held(whole, alone=False), refused, held(whole, alone=True):
        pass
    with held(whole, alone=True):
        pass
    hold = "import pathlib, sys; from jaxtrack.studies.hold import held\n"
    hold += "with held(pathlib.Path(sys.argv[1]), alone=False): print('held', flush=True); input()"
    with subprocess.Popen(
        [sys.executable, "-c", hold, str(whole)],
        env=environment(1),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    ) as other:
        assert other.stdout.readline()
        with pytest.raises(StudyError), held(whole, alone=True):
            pass
        other.kill()
        other.wait()
    with held(whole, alone=True):
        pass
