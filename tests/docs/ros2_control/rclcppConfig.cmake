# SPDX-License-Identifier: Apache-2.0
# A stand-in for rclcpp: time, loggers and nodes, as far as the controller in docs/export_c.md uses them.
add_library(rclcpp::rclcpp INTERFACE IMPORTED)
target_include_directories(rclcpp::rclcpp INTERFACE ${CMAKE_CURRENT_LIST_DIR}/include)
