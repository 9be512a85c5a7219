"""The types of the wrappers, for type checkers.

The libraries are not imported at run time. Therefore the types are `Untyped` at run time.
"""

from typing import TYPE_CHECKING, TypeAlias

from elitelanes_jax._util.types import Untyped

if TYPE_CHECKING:
    import gymnasium
    import numpy as np
    import pettingzoo
    import pufferlib
    from jaxmarl.environments.multi_agent_env import MultiAgentEnv
    from stable_baselines3.common.vec_env import VecEnv

    from elitelanes_jax._util.types import UserValue
    from elitelanes_jax.drive._lane_drive_records import LaneDriveParams
    from elitelanes_jax.drive._road_nav import RoadNavParams
    from elitelanes_jax.drive._road_traffic_records import RoadTrafficParams

    Params: TypeAlias = RoadNavParams | LaneDriveParams | RoadTrafficParams

    class GymnasiumEnv(gymnasium.Env):
        params: RoadNavParams | LaneDriveParams

    class GymnasiumVectorEnv(gymnasium.vector.VectorEnv):
        params: Params
        next_observations: np.ndarray

        def get_attr(self, name: str) -> tuple[UserValue, ...]: ...

        def set_attr(self, name: str, values: UserValue) -> None: ...

    class StableBaselines3VecEnv(VecEnv):
        params: Params
        metrics: dict[str, np.ndarray]

    class PufferLibEnv(pufferlib.PufferEnv):
        params: Params

    class JaxMarlEnv(MultiAgentEnv):
        params: RoadTrafficParams

    class PettingZooEnv(pettingzoo.ParallelEnv):
        params: RoadTrafficParams

else:
    GymnasiumEnv = GymnasiumVectorEnv = StableBaselines3VecEnv = PufferLibEnv = Untyped
    JaxMarlEnv = PettingZooEnv = Params = Untyped
