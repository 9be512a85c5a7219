"""Driving on maps: lanes, routes, environments for reinforcement learning, and what a camera sees."""
