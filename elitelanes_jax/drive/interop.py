"""Environments in the interfaces of Gymnax, Gymnasium, Stable-Baselines3 and other libraries.

None of these libraries is imported here. Each wrapper takes the module of its library as an
argument.
"""

from elitelanes_jax.drive._many_robots import jaxmarl_env, pettingzoo_env
from elitelanes_jax.drive._vectors import gymnasium_vector_env, puffer_env, sb3_vec_env
from elitelanes_jax.drive._wrappers import GymnaxEnv, gymnasium_env

__all__ = [
    "GymnaxEnv",
    "gymnasium_env",
    "gymnasium_vector_env",
    "jaxmarl_env",
    "pettingzoo_env",
    "puffer_env",
    "sb3_vec_env",
]
