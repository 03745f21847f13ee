# SPDX-License-Identifier: Apache-2.0
"""The v-dPBC tracking controller as a ROS 2 node.

From a state to its effort: the C of `native/controller_loop.c` reads the message, calls the control step of
fjr_core/runtime and publishes the command; `command_loop` starts it and takes what it recorded, `host` runs it in a
thread of its own or on an rclpy executor, and `components` builds it from the parameters of `controller_node`.
"""
