# SPDX-License-Identifier: Apache-2.0
"""Beginning of scripts in which a process records its own messages: defines sys, time, recorder and publisher."""

TALKER = """
import sys, time
from pathlib import Path
import rclpy
from std_msgs.msg import String
from fjr_monitor.recording.recorder import Recorder
recorder = Recorder(Path(sys.argv[1])).start()
rclpy.init()
node = rclpy.create_node("talker")
publisher = node.create_publisher(String, "/words", 10)
while not (publisher.get_subscription_count() and recorder.matched("/words")):
    time.sleep(0.005)
"""
