"""What worker processes of tests run: a module of its own, so that a new process imports little."""

from elitelanes_jax import SearchInterrupted, evolve


def search():
    return evolve(0, (4, 4), seeds=1, method="ea", preset="paper", generations=1)


def interrupt():
    """Raises the interruption of a search, with its result."""
    result = search()
    raise SearchInterrupted("a search was interrupted", lambda: result)
