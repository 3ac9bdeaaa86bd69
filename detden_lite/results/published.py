"""Clean returns of trained policies that others published, to compare the shipped victims with."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Published:
    """A mean clean return that others published: on which version of the task, and the key of the reference.

    Example:
        >>> PUBLISHED["hopper", "td3"].env_id
        'Hopper-v3'
    """

    mean: float
    env_id: str
    reference: str


# TD3: the benchmark table of RL Baselines3 Zoo. PPO: the undefended policies ("vanilla PPO", no attack) that the
# authors of ATLA released; they have no Humanoid, so that one is of their earlier work, SA-PPO. Rounded.
PUBLISHED = {
    ("hopper", "td3"): Published(3_606, "Hopper-v3", "raffin2020zoo"),
    ("walker2d", "td3"): Published(4_718, "Walker2d-v3", "raffin2020zoo"),
    ("halfcheetah", "td3"): Published(9_656, "HalfCheetah-v3", "raffin2020zoo"),
    ("ant", "td3"): Published(5_813, "Ant-v3", "raffin2020zoo"),
    ("humanoid", "td3"): Published(5_567, "Humanoid-v3", "raffin2020zoo"),
    ("hopper", "ppo"): Published(3_167, "Hopper-v2", "zhang2021robust"),
    ("walker2d", "ppo"): Published(4_472, "Walker2d-v2", "zhang2021robust"),
    ("halfcheetah", "ppo"): Published(7_117, "HalfCheetah-v2", "zhang2021robust"),
    ("ant", "ppo"): Published(5_687, "Ant-v2", "zhang2021robust"),
    ("humanoid", "ppo"): Published(5_271, "Humanoid-v2", "zhang2020robust"),
}
