"""Elite Lanes JAX: evolutionary generation of road networks for a miniature city.

The kernels work on one grid and are pure: `jax.jit` and `jax.vmap` them. `evolve` runs whole searches. `__init__.pyi`
lists all names; each is imported when it is first asked for, so that what needs no JAX does not wait for it.
"""


def __getattr__(name: str) -> object:
    """Reads the list of names when the first one is asked for: the command has its signals to catch before that."""
    import lazy_loader

    attached = lazy_loader.attach_stub(__name__, __file__)
    globals().update(zip(("__getattr__", "__dir__", "__all__"), attached, strict=True))
    return globals()[name] if name == "__all__" else attached[0](name)


def __dir__() -> list[str]:
    return list(__getattr__("__all__"))
