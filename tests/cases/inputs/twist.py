def act(seen):
    turn = 0.3 / 0.585 * seen.curvature[0] - 12 * seen.d - 6 * seen.phi
    return 0.3 / 1.2, turn / 8
