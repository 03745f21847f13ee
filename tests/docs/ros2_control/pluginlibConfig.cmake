# SPDX-License-Identifier: Apache-2.0
# A stand-in for pluginlib: its macro, and its function that takes the description of a plugin.
add_library(pluginlib::pluginlib INTERFACE IMPORTED)
target_include_directories(pluginlib::pluginlib INTERFACE ${CMAKE_CURRENT_LIST_DIR}/include)

function(pluginlib_export_plugin_description_file category file)
  if(NOT EXISTS ${CMAKE_CURRENT_SOURCE_DIR}/${file})
    message(FATAL_ERROR "${file} is not there; expected the description of a plugin of ${category}")
  endif()
endfunction()
