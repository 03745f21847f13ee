# SPDX-License-Identifier: Apache-2.0
# A stand-in for ament_cmake: the call that ends a package, which reads its package.xml.
macro(ament_package)
  file(READ ${CMAKE_CURRENT_SOURCE_DIR}/package.xml _ament_package_xml)
  if(NOT _ament_package_xml MATCHES "<name>${PROJECT_NAME}</name>")
    message(FATAL_ERROR "package.xml names another package; expected ${PROJECT_NAME}")
  endif()
endmacro()
