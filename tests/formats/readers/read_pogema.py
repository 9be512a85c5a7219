"""POGEMA reads the rows of MovingAI's maps, and a robot goes the shortest way of the longest task."""

from collections import deque
from pathlib import Path

import counted
from pogema import GridConfig, pogema_v0

MOVES = ((-1, 0), (1, 0), (0, -1), (0, 1))  # as POGEMA numbers them, from 1


def shortest(rows, start, goal):
    """The moves of a shortest way, one of four neighbours a step."""
    came, queue = {start: None}, deque([start])
    while queue:
        cell = queue.popleft()
        for number, (down, right) in enumerate(MOVES, 1):
            other = (cell[0] + down, cell[1] + right)
            if other not in came and rows[other[0]][other[1]] == ".":
                came[other] = cell, number
                queue.append(other)
    way = []
    while came[goal]:
        goal, number = came[goal]
        way.append(number)
    return way[::-1]


def read(file):
    rows = Path(file).read_text().splitlines()[4:]
    task = Path(file).with_suffix(".scen").read_text().splitlines()[-1].split("\t")[4:8]
    x, y, goal_x, goal_y = map(int, task)
    text = "\n".join(rows).replace("@", "#")
    places = {"agents_xy": [(y, x)], "targets_xy": [(goal_y, goal_x)]}
    env = pogema_v0(GridConfig(map=text, num_agents=1, max_episode_steps=10_000, **places))
    env.reset()
    way = shortest(rows, (y, x), (goal_y, goal_x))
    arrived = [env.step([move])[2][0] for move in way]
    assert arrived == [False] * (len(way) - 1) + [True], "the robot did not arrive at the end of its way"
    obstacles = env.unwrapped.grid.get_obstacles(ignore_borders=True)
    return {"cells": int((obstacles == 0).sum())}


counted.main(read)
