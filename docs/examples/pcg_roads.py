"""Road networks in the PCG Benchmark: ``python docs/examples/pcg_roads.py``."""

import pcg_benchmark

from elitelanes_jax.benchmark.interop import register_pcg_problems

names = register_pcg_problems()
env = pcg_benchmark.make("roads-v0")
contents = [env.content_space.sample() for _ in range(100)]
controls = [env.control_space.sample() for _ in range(100)]
quality, diversity, controlability, details, infos = env.evaluate(contents, controls)
print(quality, details["quality"].max())
env.render(contents[0]).save("pcg-roads.png")
