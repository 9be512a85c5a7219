"""Driving on maps: lanes, routes, environments for reinforcement learning, and a camera."""

from elitelanes_jax._util.faces import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
