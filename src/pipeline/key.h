// SPDX-License-Identifier: Apache-2.0
// What a stage's result depends on, as one hash: it names the stage's folder in OUT/stages.
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "pipeline/option_hash.h"
#include "base/sha256.h"
#include "vdbcarve/geometry.h"
#include "vdbcarve/version.h"

namespace vdbcarve::pipeline {

inline void add_camera(Sha256& hash, const Camera& c) {
    const Intrinsics& k = c.intrinsics;
    for (const double v : {k.fx, k.fy, k.skew, k.cx, k.cy}) hash.add_value(v);
    hash.add_value(k.width_px).add_value(k.height_px).add_value(k.orthographic);
    for (int i = 0; i < 9; ++i) hash.add_value(c.camera_from_world.rotation(i / 3, i % 3));
    for (int i = 0; i < 3; ++i) hash.add_value(c.camera_from_world.translation[i]);
}

/// Key("color").of(surface.key).of(options): whole structs of options go in, by their visit(), so that no field can be forgotten.
class Key {
  public:
    explicit Key(const char* stage) { hash_.add(stage).add_value(kCodeVersion); }

    template <class T>
    Key& of(const T& value) {
        if constexpr (requires(OptionHasher & visitor) { visit(value, visitor); }) hash_options(hash_, value);
        else if constexpr (std::is_convertible_v<T, std::string_view>) hash_.add(std::string_view(value));
        else ValueHasher(hash_).add(value);
        return *this;
    }
    Key& of(const Camera& camera) {
        add_camera(hash_, camera);
        return *this;
    }
    Key& of(const std::vector<Camera>& cameras) {
        of(cameras.size());
        for (const Camera& c : cameras) of(c);
        return *this;
    }
    std::string hex() { return hash_.hex(); }

  private:
    Sha256 hash_;
};

}  // namespace vdbcarve::pipeline
