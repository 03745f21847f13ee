# SPDX-License-Identifier: Apache-2.0
# A stand-in for pluginlib: its macro.
add_library(pluginlib::pluginlib INTERFACE IMPORTED)
target_include_directories(pluginlib::pluginlib INTERFACE ${CMAKE_CURRENT_LIST_DIR}/include)
