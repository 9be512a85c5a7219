"""Runs of `generate` in process after process, each killed at a random moment.

python killed_runs.py OUT KILLS SEED: prints a line of JSON with the digest of the folder for every run that was done,
the first of which was never killed, and one with the number of kills at the end. Processes are forked, so that only one
imports everything.
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

from elitelanes_jax import GenerateSpec, SearchSpec, use_compile_cache
from elitelanes_jax.maps import generation as module

__all__ = ["SPEC", "digest"]

SPEC = GenerateSpec(
    size=(5, 6),
    seeds=3,
    maps=2,
    tile_px=16,
    search=SearchSpec(method="ea", preset="paper", generations=900),
)


def digest(folder):
    """A digest of all files and their names, but for the times in ``run.json``."""
    found = files(folder)
    record = json.loads(found["run.json"])
    del record["times"]
    found["run.json"] = json.dumps(record).encode()
    return sha256(b"".join(name.encode() + content for name, content in sorted(found.items()))).hexdigest()


def _fork(out):
    child = os.fork()
    if child:
        return child
    try:
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
        use_compile_cache()
        module._SECONDS_A_CHECKPOINT = module._WORTH_KEEPING = 0
        module.generate(SPEC, out)
        os._exit(0)
    except BaseException:
        traceback.print_exc()
        os._exit(70)


def _wait(child, seconds=None):
    """Waits for a process, and kills it after so many seconds; returns whether it was killed."""
    began = time.monotonic()
    while True:
        pid, status = os.waitpid(child, os.WNOHANG)
        if pid:
            code = os.waitstatus_to_exitcode(status)
            if code not in (0, -signal.SIGKILL):
                raise SystemExit(f"a run ended with {code}")
            return code != 0
        if seconds is not None and time.monotonic() - began >= seconds:
            os.kill(child, signal.SIGKILL)
            seconds = None
        time.sleep(0.001)


def main(out, kills, seed):
    out, rng, killed = Path(out), random.Random(int(seed)), 0
    use_compile_cache()
    _wait(_fork(out))  # compiles
    print(json.dumps({"digest": digest(out)}), flush=True)
    shutil.rmtree(out)
    lately = deque(maxlen=5)  # the seconds of runs that were done
    while True:
        if out.exists():
            print(json.dumps({"digest": digest(out)}), flush=True)
            if killed == int(kills):
                break
            shutil.rmtree(out)
        began = time.monotonic()
        ended = _wait(_fork(out), rng.uniform(0, max(lately)) if lately and killed < int(kills) else None)
        killed += ended
        if not ended:
            lately.append(time.monotonic() - began)
    print(json.dumps({"kills": killed}))


if __name__ == "__main__":
    main(*sys.argv[1:])
