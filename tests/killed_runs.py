"""Runs of `generate` or `make_dataset` in process after process, each ended by a signal at a random moment.

python killed_runs.py OUT KILLS SEED [maps|dataset|evolved SIGNAL...]

Prints a line of JSON for each completed run, with the digest of its folder, and a last line with the number of kills.
No signal is sent during the first run. Processes are forked, so that only one imports everything.
"""

import json
import os
import random
import shutil
import signal
import sys
import time
import traceback
from collections import deque
from hashlib import sha256
from pathlib import Path

import jax
from folders import files
from given_maps import random_maps, small

from elitelanes_jax import GenerateSpec, SearchSpec, make_dataset, use_compile_cache
from elitelanes_jax.cli.program import guarded, leave
from elitelanes_jax.maps import generation

__all__ = ["digest"]

SPEC = GenerateSpec(
    size=(5, 6), seeds=3, maps=2, tile_px=16, search=SearchSpec(method="ea", preset="paper", generations=900)
)
EVOLVED = small(maps_from=None, maps=20, size="3..4 4", search=SearchSpec(preset="paper", evaluations=2000))
MANY = small(maps_from=random_maps(40, side=8))
RUNS = {
    "maps": lambda out, _: generation.generate(SPEC, out),
    "dataset": lambda out, workers: make_dataset(MANY, out, workers=workers),
    "evolved": lambda out, workers: make_dataset(EVOLVED, out, workers=workers),
}
LONGEST = 60  # seconds until a signal must have been heard: a compilation is not interrupted, and machines are shared


def digest(folder):
    """Returns a digest of all files and their names, without the times in ``run.json``."""
    found = files(folder)
    if "run.json" in found:
        record = json.loads(found["run.json"])
        del record["times"]
        found["run.json"] = json.dumps(record).encode()
    return sha256(b"".join(name.encode() + content for name, content in sorted(found.items()))).hexdigest()


def fork(run, said):
    """Returns a new process, once it is at work; what it says on standard error goes to a file."""
    began, ready = os.pipe()
    child = os.fork()
    if child:
        os.close(ready)
        os.read(began, 1)
        os.close(began)
        return child
    os.dup2(os.open(said, os.O_CREAT | os.O_WRONLY | os.O_TRUNC), 2)

    def work():
        os.write(ready, b".")
        run()
        return 0

    try:
        leave(lambda: guarded("ended", work, interrupted="it continues"))
    except SystemExit as stop:
        os._exit(stop.code)
    except BaseException:
        traceback.print_exc()
    os._exit(70)


def wait(child, seconds=None, name="SIGKILL"):
    """Waits for a process, and sends it a signal after `seconds`; returns its exit code."""
    began = time.monotonic()
    while True:
        pid, status = os.waitpid(child, os.WNOHANG)
        if pid:
            return os.waitstatus_to_exitcode(status)
        if seconds is not None and time.monotonic() - began >= seconds:
            os.kill(child, getattr(signal, name))
            began, seconds, name = time.monotonic(), LONGEST, "SIGKILL"
        time.sleep(0.001)


def main(out, kills, seed, what="maps", *names):
    out, rng, said, killed = Path(out), random.Random(int(seed)), Path(f"{out}.said"), 0
    signal.signal(signal.SIGINT, signal.default_int_handler)  # it may have been ignored, as nohup does
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    use_compile_cache()
    generation._SECONDS_A_CHECKPOINT = generation._WORTH_KEEPING = 0
    lately = deque(maxlen=5)  # seconds of the last completed runs, without the first, which compiles
    done = 0
    while killed < int(kills) or not out.exists():
        if out.exists():
            shutil.rmtree(out)
        name, workers, began = rng.choice(names or ["SIGKILL"]), rng.randint(1, 8), time.monotonic()
        child = fork(lambda workers=workers: RUNS[what](out, workers), said)
        ended = rng.uniform(0, max(lately)) if lately and killed < int(kills) else None
        code, words = wait(child, ended, name), said.read_text()
        if code == 0:
            lately += [time.monotonic() - began] * bool(done)
            done += 1
            print(json.dumps({"digest": digest(out)}), flush=True)
        elif code == (-signal.SIGKILL if name == "SIGKILL" else 130) and "Traceback" not in words:
            killed += 1
            assert name == "SIGKILL" or words.endswith("ended: interrupted; it continues\n"), words
        else:
            raise SystemExit(f"a run ended with {code}: {words}")
    said.unlink()
    print(json.dumps({"kills": killed}))


if __name__ == "__main__":
    main(*sys.argv[1:])
