"""The simulated swarm. This package imports neither Gymnasium nor detectors and knows no rewards.

``FOLLOW_STRATEGIES``, ``FORMATIONS``, ``KINEMATICS`` and ``MOBILITIES`` are the registered parts by name, as mappings.
"""

from usnet_env.swarm.config import SwarmConfig
from usnet_env.swarm.follow import FOLLOW_STRATEGIES, register_follow_strategy
from usnet_env.swarm.formation import FORMATIONS, register_formation
from usnet_env.swarm.kinematics import KINEMATICS, Kinematics, register_kinematics
from usnet_env.swarm.mobility import MOBILITIES, Mobility, register_mobility
from usnet_env.swarm.sensing import ObservationBatch
from usnet_env.swarm.simulator import advance, start
from usnet_env.swarm.state import SwarmState, destroy
from usnet_env.swarm.strategy import FollowInputs, FollowStrategy

__all__ = ["ObservationBatch", "SwarmConfig", "SwarmState", "advance", "destroy", "start"]
__all__ += ["FOLLOW_STRATEGIES", "FollowInputs", "FollowStrategy", "register_follow_strategy"]
__all__ += ["KINEMATICS", "MOBILITIES", "Kinematics", "Mobility", "register_kinematics", "register_mobility"]
__all__ += ["FORMATIONS", "register_formation"]
