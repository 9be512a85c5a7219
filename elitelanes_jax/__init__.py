"""Elite Lanes JAX: evolutionary generation of road networks for a miniature city.

The kernels work on one grid and are pure: `jax.jit` and `jax.vmap` them. `evolve` runs whole
searches. `__init__.pyi` lists all names. Each name is imported at its first use, so that code
without JAX does not wait for JAX.
"""


def __getattr__(name: str) -> object:
    """Reads the list of names at the first use of a name, so that the command can catch signals before that."""
    import lazy_loader

    attached = lazy_loader.attach_stub(__name__, __file__)
    globals().update(zip(("__getattr__", "__dir__", "__all__"), attached, strict=True))
    return globals()[name] if name == "__all__" else attached[0](name)


def __dir__() -> list[str]:
    return list(__getattr__("__all__"))
