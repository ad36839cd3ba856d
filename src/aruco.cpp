// SPDX-License-Identifier: Apache-2.0
#include "aruco.h"

#include <opencv2/core/version.hpp>
#if CV_VERSION_MAJOR > 4 || (CV_VERSION_MAJOR == 4 && CV_VERSION_MINOR >= 7)
#define VDBCARVE_ARUCO_IN_OBJDETECT 1
#include <opencv2/objdetect/aruco_dictionary.hpp>
#else
#define VDBCARVE_ARUCO_IN_OBJDETECT 0
#include <opencv2/aruco.hpp>
#endif

#include <map>

#include "opencv_image.h"

namespace vdbcarve {
namespace {

struct Named {
    int number, size, bits;
};
const Named* named(const std::string& name) {
    static const std::map<std::string, Named> all = [] {
        // OpenCV numbers them in this order, from 0.
        std::map<std::string, Named> out;
        int number = 0;
        for (const int bits : {4, 5, 6, 7})
            for (const int size : {50, 100, 250, 1000}) out[std::to_string(bits) + "X" + std::to_string(bits) + "_" + std::to_string(size)] = {number++, size, bits};
        return out;
    }();
    const auto found = all.find(name);
    return found == all.end() ? nullptr : &found->second;
}

}  // namespace

int dictionary_size(const std::string& name) {
    const Named* n = named(name);
    return n ? n->size : 0;
}

int marker_bits(const std::string& name) { return named(name)->bits; }

Image8 marker_image(const std::string& dictionary, int id, int side) {
    cv::Mat out;
#if VDBCARVE_ARUCO_IN_OBJDETECT
    cv::aruco::generateImageMarker(cv::aruco::getPredefinedDictionary(named(dictionary)->number), id, side, out, 1);
#else
    cv::aruco::drawMarker(cv::aruco::getPredefinedDictionary(named(dictionary)->number), id, side, out, 1);
#endif
    return io::unwrap(out);
}

}  // namespace vdbcarve
