"""CAMAR reads the rows of MovingAI's maps, and its robots take a step."""

from pathlib import Path

import camar
import counted
import jax
import jax.numpy as jnp


def read(file):
    rows = Path(file).read_text().splitlines()[4:]
    text = "\n".join(rows).replace("@", "#")
    env = camar.camar_v0(
        map_generator="string_grid", map_kwargs={"map_str": text, "num_agents": 2, "add_border": False}
    )
    key = jax.random.key(0)
    _, state = env.reset(key)
    env.step(key, state, jnp.zeros((env.num_agents, 2)))
    return {"cells": sum(map(len, rows)) - env.num_landmarks}


counted.main(read)
