// SPDX-License-Identifier: Apache-2.0
// Compiled by layers_test.sh as if it belonged to a module that uses `views`: one header a target, allowed or not.
#include VDBCARVE_HEADER
