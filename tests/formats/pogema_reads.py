"""Has POGEMA read MovingAI's maps, in an environment of its own: python pogema_reads.py FOLDER, with PNAME.map files.

A robot goes the shortest way from the start to the goal of each map's longest task, one of four neighbours a step.
"""

import sys
from collections import deque
from pathlib import Path

from pogema import GridConfig, pogema_v0


def read(file):
    """The rows of a map, and the start and the goal of its last task, (row, column)."""
    rows = file.read_text().splitlines()[4:]
    x, y, goal_x, goal_y = map(int, file.with_suffix(".scen").read_text().splitlines()[-1].split("\t")[4:8])
    return rows, (y, x), (goal_y, goal_x)


def shortest(rows, start, goal):
    """The moves of a shortest way, as POGEMA numbers them."""
    moves = [(-1, 0), (1, 0), (0, -1), (0, 1)]
    came, queue = {start: None}, deque([start])
    while queue:
        cell = queue.popleft()
        for number, (down, right) in enumerate(moves, 1):
            other = (cell[0] + down, cell[1] + right)
            if other not in came and rows[other[0]][other[1]] == ".":
                came[other] = cell, number
                queue.append(other)
    way = []
    while came[goal]:
        goal, number = came[goal]
        way.append(number)
    return way[::-1]


for file in sorted(Path(sys.argv[1]).glob("*.map")):
    rows, start, goal = read(file)
    text = "\n".join(rows).replace("@", "#")
    config = GridConfig(map=text, agents_xy=[start], targets_xy=[goal], num_agents=1, max_episode_steps=10_000)
    env = pogema_v0(config)
    env.reset()
    way = shortest(rows, start, goal)
    for number, move in enumerate(way, 1):
        _, _, terminated, _, _ = env.step([move])
        assert terminated[0] == (number == len(way)), (file, number, len(way))
print("read")
