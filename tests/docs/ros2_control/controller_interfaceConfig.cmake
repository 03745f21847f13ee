# SPDX-License-Identifier: Apache-2.0
# A stand-in for ros2_control's package: what the controller in docs/export_c.md uses of it, declared.
add_library(controller_interface::controller_interface INTERFACE IMPORTED)
target_include_directories(controller_interface::controller_interface INTERFACE ${CMAKE_CURRENT_LIST_DIR}/include)
