"""The simulated swarm. This package imports neither Gymnasium nor detectors and knows no rewards."""

from usnet_env.swarm.config import SwarmConfig
from usnet_env.swarm.follow import FollowInputs, FollowStrategy, follow_strategies, register_follow_strategy
from usnet_env.swarm.formation import formations, register_formation
from usnet_env.swarm.kinematics import Kinematics, kinematics_models, register_kinematics
from usnet_env.swarm.mobility import Mobility, mobilities, register_mobility
from usnet_env.swarm.sensing import ObservationBatch
from usnet_env.swarm.simulator import advance, start
from usnet_env.swarm.state import SwarmState, destroy

__all__ = [
    "FollowInputs",
    "FollowStrategy",
    "Kinematics",
    "Mobility",
    "ObservationBatch",
    "SwarmConfig",
    "SwarmState",
    "advance",
    "destroy",
    "follow_strategies",
    "formations",
    "kinematics_models",
    "mobilities",
    "register_follow_strategy",
    "register_formation",
    "register_kinematics",
    "register_mobility",
    "start",
]
