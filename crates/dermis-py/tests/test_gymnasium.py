"""Skins as observations of Gymnasium environments: spaces, values, vectors of environments, and invalid input."""

import numpy as np
import pytest

gymnasium = pytest.importorskip("gymnasium", reason="Gymnasium is not installed")
mujoco = pytest.importorskip("mujoco", reason="MuJoCo is not installed")

from gymnasium import spaces
from gymnasium.utils.env_checker import check_env

import dermis
from dermis.errors import InputError
from dermis.gymnasium import SkinObservation
from dermis.mujoco import Patch

SCENE = """
<mujoco>
  <option timestep="0.002"/>
  <worldbody>
    <geom name="plate" type="box" size="0.05 0.05 0.01" pos="0 0 -0.01"/>
    <body name="finger" pos="0 0 0.02">
      <joint type="slide" axis="1 0 0" damping="1"/><joint type="slide" axis="0 0 1" damping="10"/>
      <geom type="sphere" size="0.015" mass="0.2"/>
    </body>
  </worldbody>
  <actuator><motor joint="0"/></actuator>
</mujoco>
""".replace('<joint type="slide" axis="0 0 1"', '<joint name="press" type="slide" axis="0 0 1"').replace('joint="0"', 'joint="press"')


class Finger(gymnasium.Env):
    """A finger pushes on a plate; the action is its force, newtons upwards."""

    observation_space = spaces.Box(-np.inf, np.inf, (2,))
    action_space = spaces.Box(-20, 0, (1,))

    def __init__(self):
        self.model = mujoco.MjModel.from_xml_string(SCENE)
        self.data = mujoco.MjData(self.model)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        mujoco.mj_resetData(self.model, self.data)
        mujoco.mj_forward(self.model, self.data)
        return self.data.qpos.astype(np.float32), {}

    def step(self, action):
        self.data.ctrl[:] = action
        mujoco.mj_step(self.model, self.data, 5)
        return self.data.qpos.astype(np.float32), 0.0, False, False, {}


@pytest.fixture(scope="module")
def square():
    return dermis.Skin("healing-square").model()


def touching(square, **options):
    return SkinObservation(Finger(), Patch("plate", square, geom="plate", xyz_mm=(0, 0, 10)), **options)


def test_observations_are_in_their_space(square):
    env = touching(square, observe=("frame", "change", "taxels", "touches"), most_touches=3)
    observation, _ = env.reset(seed=1)
    assert env.observation_space.contains(observation)
    shapes = {kind: array.shape for kind, array in observation["skin"]["plate"].items()}
    taxels = len(env.taxels_mm("plate"))
    assert shapes == {"frame": (208,), "change": (208,), "taxels": (taxels,), "touches": (3, 7)}
    assert not observation["skin"]["plate"]["touches"].any()
    for _ in range(60):
        observation, *_ = env.step(np.array([-20.0]))
    assert env.observation_space.contains(observation)
    felt = observation["skin"]["plate"]
    assert felt["touches"][0, 0] == 1 and np.hypot(*felt["touches"][0, 1:3]) < 3
    assert not felt["touches"][1:].any()
    place = env.taxels_mm("plate")[np.argmax(np.abs(felt["taxels"]))]
    assert np.hypot(*place) < 6
    observation, _ = env.reset()
    assert not observation["skin"]["plate"]["touches"].any()


def test_gymnasiums_own_checker_is_content(square):
    # The checker resets twice with one seed, but the noise continues.
    check_env(touching(square, observe="touches"), skip_render_check=True)


def test_a_vector_of_environments(square):
    envs = gymnasium.vector.SyncVectorEnv([lambda: touching(square), lambda: touching(square)])
    observation, _ = envs.reset(seed=1)
    assert observation["skin"]["plate"]["touches"].shape == (2, 5, 7)
    observation, *_ = envs.step(np.full((2, 1), -5.0))
    assert envs.observation_space.contains(observation)
    envs.close()


def test_a_dictionary_keeps_its_keys(square):
    class Named(gymnasium.ObservationWrapper):
        def __init__(self, env):
            super().__init__(env)
            self.observation_space = spaces.Dict({"place": env.observation_space})

        def observation(self, observation):
            return {"place": observation}

    env = SkinObservation(Named(Finger()), Patch("plate", square, geom="plate", xyz_mm=(0, 0, 10)))
    assert set(env.reset()[0]) == {"place", "skin"} == set(env.observation_space.spaces)


def test_what_is_wrong_is_named(square):
    with pytest.raises(InputError, match="observe = 'pressure': expected any of frame, change, taxels, touches"):
        touching(square, observe="pressure")
    with pytest.raises(InputError, match="most_touches = 0"):
        touching(square, most_touches=0)
    with pytest.raises(InputError, match="env: expected one with MuJoCo's model and data"):
        SkinObservation(gymnasium.make("CartPole-v1"), Patch("plate", square, geom="plate"))
    with pytest.raises(InputError, match="geom = 'palm'"):
        SkinObservation(Finger(), Patch("plate", square, geom="palm"))
