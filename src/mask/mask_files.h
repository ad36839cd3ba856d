// SPDX-License-Identifier: Apache-2.0
// Where masks lie, and what is a mask. Private.
#pragma once

#include <filesystem>

#include "vdbcarve/image.h"
#include "vdbcarve/mask.h"

namespace vdbcarve {

/// A file that is a mask: grey, or grey spelled as RGB, or the alpha of RGBA. Throws InputError naming the path for colours.
Image8 grey_of(const Image8& file, const std::filesystem::path& path);

/// Numbers of classes instead of grey values. Throws InputError.
void refuse_class_numbers(const Image8& mask, const std::filesystem::path& path);

/// Nearly all of it black or white.
bool is_two_level(const Image8& grey);

/// A view's file in a folder: in the view's own subfolder first (masks/cam0/0001.png), then directly; two views that end at one file are
/// refused in make_masks. Empty: there is none.
std::filesystem::path file_in_folder(const std::filesystem::path& folder, const View& view);

/// The object mask's file, by the search order that docs/formats.md documents. Empty: there is none.
std::filesystem::path object_mask_file(const View& view, const std::filesystem::path& scene, const MaskOptions& options);
std::filesystem::path ignore_mask_file(const View& view, const std::filesystem::path& scene, const MaskOptions& options);

/// The clean plate of a view: the one there is, or the view's own in a folder. Throws InputError where it is missing.
std::filesystem::path plate_file(const View& view, const std::filesystem::path& scene, const MaskOptions& options);

}  // namespace vdbcarve
