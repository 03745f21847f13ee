// SPDX-License-Identifier: Apache-2.0
// In place of pluginlib's registration: a function that makes the controller, which a test calls.
#pragma once

#define PLUGINLIB_EXPORT_CLASS(Class, Base) \
  extern "C" Base * made_by_plugin() { return new Class(); }
