"""Progress bars, in a terminal or a notebook."""

import shutil
import sys
from types import TracebackType
from typing import Any

__all__ = ["Progress", "counter"]


class Progress:
    """A progress bar of a run: generation, best fitness, elites, evaluations per second, time left.

    Args:
      name: of the run.
      done: generations done before.
      last: generations to be done in all.
      shown: whether to show it at once; by default in a terminal or notebook, when the run takes over a second.
    """

    def __init__(self, name: str, done: int, last: int, *, shown: bool | None = None) -> None:
        self._bar: Any = None
        if shown if shown is not None else sys.stderr.isatty() or "ipykernel" in sys.modules:
            from tqdm import tqdm  # the kernels do without it

            self._bar = tqdm(
                desc=name,
                initial=done,
                total=last,
                delay=0 if shown else 1,
                ncols=None if sys.stderr.isatty() else shutil.get_terminal_size((100, 24)).columns,
                # The figures stand first, as a narrow terminal cuts off the end.
                bar_format="{desc} {n_fmt}/{total_fmt}{postfix}, {remaining} left |{bar}|",
            )

    def show(self, done: int, best: float, elites: float, speed: float) -> None:
        """Shows generations done, best fitness, elites, and evaluations per second."""
        if self._bar is not None:
            postfix = f"best {best:,.0f}, {elites:,.0f} elites, {_short(speed)} evals/s"
            self._bar.set_postfix_str(postfix, refresh=False)
            self._bar.update(done - self._bar.n)

    def __enter__(self) -> "Progress":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.close()


def counter(name: str, total: int, unit: str, done: int = 0) -> Any:
    """Makes a progress bar that counts, with speed and time left: a context with ``update(more)``.

    Args:
      name: of the work.
      total: the count at the end.
      unit: of the count.
      done: the count at the start.
    """
    from tqdm import tqdm

    return tqdm(
        desc=name,
        initial=done,
        total=total,
        unit=f" {unit}",
        disable=not (sys.stderr.isatty() or "ipykernel" in sys.modules),
        bar_format="{desc} {n_fmt}/{total_fmt}{unit}, {rate_noinv_fmt}, {remaining} left |{bar}|",
    )


def _short(number: float) -> str:
    for factor, unit in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if number >= factor:
            return f"{number / factor:.3g}{unit}"
    return f"{number:.3g}"
