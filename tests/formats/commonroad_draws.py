"""Draws a scenario as CommonRoad does: python commonroad_draws.py SCENARIO.xml WIDTH HEIGHT PIXELS OUT.png.

WIDTH and HEIGHT of the map are in metres, PIXELS is the width of the picture. `docs/simulators.py` calls it in
CommonRoad's own environment, which does not have our package.
"""

import sys

import matplotlib

matplotlib.use("Agg")

from commonroad.common.file_reader import CommonRoadFileReader
from commonroad.visualization.draw_params import MPDrawParams
from commonroad.visualization.mp_renderer import MPRenderer
from matplotlib import pyplot as plt


def main() -> None:
    file, width, height, pixels, out = sys.argv[1:]
    east, north = float(width), float(height)
    inches = int(pixels) / 100
    figure = plt.figure(figsize=(inches, inches * north / east), dpi=100)
    axes = figure.add_axes((0, 0, 1, 1))
    scenario, problems = CommonRoadFileReader(file).open()
    params = MPDrawParams()
    params.axis_visible = False
    renderer = MPRenderer(params, plot_limits=[0, east, 0, north], ax=axes)
    scenario.draw(renderer)
    problems.draw(renderer)
    renderer.render()
    figure.savefig(out)


if __name__ == "__main__":
    main()
