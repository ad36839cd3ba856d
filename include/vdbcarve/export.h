// SPDX-License-Identifier: Apache-2.0
// Stage `export`: volumes to and from .vdb and .nvdb files; axes and units of all files. Both headers in one, for users of the library.
#pragma once

#include "vdbcarve/file_frame.h"
#include "vdbcarve/volume.h"
