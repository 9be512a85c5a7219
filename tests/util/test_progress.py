"""Progress: a line that changes in a terminal, lines in a log, nothing where nobody asked."""

import io
import sys
import time
from itertools import pairwise

import pytest

from elitelanes_jax._util import progress
from elitelanes_jax._util.progress import Progress, announce, reporting


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.fixture
def fast(monkeypatch):
    """A second is a hundredth of one."""
    for name in ("_REDRAW", "_LINES", "_DELAY"):
        monkeypatch.setattr(progress, name, getattr(progress, name) / 100)


@pytest.fixture
def listen(monkeypatch):
    """Puts a stream in the place of standard error; not before the test, as pytest has its own there until then."""

    def put(stream):
        monkeypatch.setattr(sys, "stderr", stream)
        return stream

    return put


def work(stream=None, **options):
    """A step of 0.1 s, or until a stream shows it, then ten counts within 0.1 s, with a smaller work within."""
    with Progress("digging", 10, "holes", **options) as bar:
        with bar.doing("sharpening"):
            time.sleep(0.1)
            # On a busy machine the thread that draws may come late.
            until = time.monotonic() + 10
            while stream and "sharpening" not in stream.getvalue() and time.monotonic() < until:
                time.sleep(0.01)
        for number in range(10):
            with Progress("one"):
                time.sleep(0.01)
            bar.update(number + 1, "deep")


def test_a_terminal_shows_each_step_while_it_happens_and_the_end_stays(listen, fast):
    stream = listen(Terminal())
    work(stream)
    drawn = stream.getvalue().split("\r")
    assert any(line.startswith("digging: sharpening, 0 s") for line in drawn)
    assert any("holes, deep, 0:00 left; one, 0 s" in line for line in drawn)
    assert drawn[-1].rstrip(" \n") == "digging 10/10 holes, deep" and drawn[-1].endswith("\n")
    assert all(len(line.rstrip("\n")) >= len(before.rstrip()) for before, line in pairwise(drawn))


def test_short_work_shows_nothing_unless_it_is_asked_for(listen):
    stream = listen(Terminal())
    with Progress("digging", 10, "holes") as bar:
        bar.count(10)
    assert stream.getvalue() == ""
    with Progress("digging", 10, "holes", shown=True) as bar:
        bar.count(10)
    assert "digging 10/10 holes" in stream.getvalue()


def test_a_script_says_nothing_unless_it_is_asked_to(listen, fast):
    stream = listen(io.StringIO())
    work()
    announce("digging")
    assert stream.getvalue() == ""
    work(stream, shown=True)
    lines = stream.getvalue().splitlines()
    assert "digging: sharpening, 0 s" in lines
    assert lines[-1].startswith("digging 10/10 holes, deep")


def test_a_commands_log_has_a_line_every_30_seconds_over_all_works(listen, monkeypatch):
    stream = listen(io.StringIO())
    monkeypatch.setattr(progress, "_LINES", 0.15)
    with reporting(quiet=False):
        announce("start")
        for _ in range(2):
            with Progress("digging"):
                time.sleep(0.1)
            with Progress("digging", shown=False):
                pass
    assert stream.getvalue() == "start\ndigging, 0 s\n"
    with reporting(quiet=False):
        time.sleep(0.2)
    assert stream.getvalue().count("digging") == 1


def test_a_quiet_command_says_nothing(listen, fast):
    stream = listen(Terminal())
    with reporting(quiet=True):
        work(shown=True)
        announce("start")
    assert stream.getvalue() == ""


class Broken(Terminal):
    def write(self, text):
        raise BrokenPipeError


class Closed(Terminal):
    def __init__(self):
        super().__init__()
        self.close()


@pytest.mark.parametrize("stream", [lambda: None, Broken, Closed])
def test_work_goes_on_where_nobody_listens(stream, listen, fast):
    listen(stream())
    with reporting(quiet=False):
        announce("start")
        work()


def test_an_error_leaves_the_state_at_which_it_came(listen, fast):
    stream = listen(Terminal())

    def fails():
        with Progress("digging", 10, "holes") as bar:
            bar.count(3)
            time.sleep(0.1)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fails()
    assert "digging 3/10 holes" in stream.getvalue().split("\r")[-1]
    assert stream.getvalue().endswith("\n")
    work()
    assert "digging 10/10" in stream.getvalue()


def test_the_remaining_time_follows_from_what_was_done_since_the_last_step(monkeypatch):
    times = [0.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: times[0])
    bar = Progress("digging", 10, "holes")
    bar.update(5)
    times[0] = 50.0
    with bar.doing("sharpening"):
        times[0] = 60.0
    bar.update(6)
    times[0] = 70.0
    # One hole took 10 s, and 4 are left.
    assert str(bar) == "digging 6/10 holes, 0:40 left"
