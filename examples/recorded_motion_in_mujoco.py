# SPDX-License-Identifier: Apache-2.0
"""Repeat a recorded motion in MuJoCo alone: fjr export-mjcf arm7 arm.xml; fjr run arm7 --lockstep --duration 2

pip install mujoco mcap-ros2-support; python recorded_motion_in_mujoco.py arm.xml runs/arm7/bag/bag_0.mcap
"""

import sys

import mujoco
import numpy as np
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

arm, bag = sys.argv[1:]
model = mujoco.MjModel.from_xml_path(arm)
data = mujoco.MjData(model)
mujoco.mj_resetDataKeyframe(model, data, 0)  # the initial state of the scenario
with open(bag, "rb") as file:
    reader = make_reader(file, decoder_factories=[DecoderFactory()])
    states = [state for *_, state in reader.iter_decoded_messages(topics=["/joint_states"])]
stamps = [(state.header.stamp.sec, state.header.stamp.nanosec) for state in states]
first, *states = dict(zip(stamps, states, strict=True)).values()  # a state that is answered late is sent again
steps = round((states[0].header.stamp.nanosec - first.header.stamp.nanosec) % 10**9 * 1e-9 / model.opt.timestep)
motors = [first.name.index(model.actuator(i).name) for i in range(model.nu)]
place = [model.joint(name).qposadr[0] for name in first.name]
apart = 0.0
for state in states[:2000]:  # two seconds; each reports the effort that was held since the one before
    data.ctrl = np.array(state.effort)[motors] / model.actuator_gear[:, 0]
    mujoco.mj_step(model, data, steps)
    apart = max(apart, np.abs(data.qpos[place] - state.position).max())
print(f"{len(states[:2000])} states of {len(place)} coordinates, at most {apart:.1e} rad apart")
