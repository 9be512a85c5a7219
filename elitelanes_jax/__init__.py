"""Elite Lanes JAX: evolutionary generation of road networks for a miniature city.

The kernels work on one grid and are pure: `jax.jit` and `jax.vmap` them. `evolve` runs whole
searches. `__init__.pyi` lists all names. Each name is imported at its first use, so that code
without JAX does not wait for JAX.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
