def act(seen):
    return seen.height
