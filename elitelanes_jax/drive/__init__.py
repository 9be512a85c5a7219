"""Driving on maps: lanes, routes, environments for reinforcement learning, and a camera."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
