"""Makes one dataset of given maps in process after process, each ended by a signal at a random moment.

python ended_runs.py OUT RUNS SEED SIGNAL...: prints a line of JSON for each process that was ended before it was done,
``{"signal": NAME, "code": N, "seconds": N, "said": TEXT}``: the seconds from the signal to the end, and the text on
standard error. A dataset that was done is begun again. Processes are forked, so that only one imports everything.
"""

import json
import os
import random
import shutil
import signal
import sys
import time
import traceback
from pathlib import Path

from given_maps import random_maps, small

from elitelanes_jax.cli.program import guarded, leave
from elitelanes_jax.dataset.make import make_dataset

__all__ = ["MAPS", "SPEC"]

SPEC, MAPS = small(maps=40, split=(0.8, 0.1, 0.1)), random_maps(40)
_LONGEST = 30


def _make(out, workers, ready):
    os.write(ready, b".")
    make_dataset(SPEC, out, workers=workers, maps=MAPS)
    return 0


def _fork(out, workers, said):
    """Returns a new process, once it is at work."""
    began, ready = os.pipe()
    child = os.fork()
    if child:
        os.close(ready)
        os.read(began, 1)
        os.close(began)
        return child
    os.dup2(os.open(said, os.O_CREAT | os.O_WRONLY | os.O_TRUNC), 2)
    try:
        leave(lambda: guarded("ended", lambda: _make(out, workers, ready), interrupted="it continues"))
    except SystemExit as stop:
        os._exit(stop.code)
    except BaseException:
        traceback.print_exc()
        os._exit(70)


def _ended(child):
    """Returns the exit code of a process that has ended, else None."""
    pid, status = os.waitpid(child, os.WNOHANG)
    return os.waitstatus_to_exitcode(status) if pid else None


def _end(child, records, count, wait, name):
    """Signals a process a while after it has drawn so many pictures; returns its exit code and how long it took."""
    while sum(1 for _ in records.glob("*/[!.]*")) < count:
        if (code := _ended(child)) is not None:
            return code, 0.0
        time.sleep(0.001)
    time.sleep(wait)
    began = time.monotonic()
    os.kill(child, getattr(signal, name))
    while (code := _ended(child)) is None:
        if time.monotonic() - began > _LONGEST:
            os.kill(child, signal.SIGKILL)
        time.sleep(0.001)
    return code, time.monotonic() - began


def main(out, runs, seed, *names):
    out, rng, said = Path(out), random.Random(int(seed)), Path(f"{out}.said")
    signal.signal(signal.SIGINT, signal.default_int_handler)  # it may have been ignored, as nohup does
    records, ended = out.with_name(f".{out.name}-unfinished") / "kept" / "records", 0
    while ended < int(runs):
        there = sum(1 for _ in records.glob("*/[!.]*"))
        child = _fork(out, rng.randint(1, 8), said)
        name = rng.choice(names)
        code, seconds = _end(child, records, rng.randint(there, there + 12), rng.uniform(0, 0.004), name)
        if code == 0:
            shutil.rmtree(out)
        else:
            ended += 1
            record = {"signal": name, "code": code, "seconds": seconds, "said": said.read_text()}
            print(json.dumps(record), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
