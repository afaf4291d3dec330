// SPDX-License-Identifier: MIT
// What the sensors sent since the last estimate. Nothing here depends on ROS.
#ifndef RHEC_ROS2_SAMPLES_HPP
#define RHEC_ROS2_SAMPLES_HPP

#include <cmath>
#include <limits>

namespace rhec_ros2 {

constexpr double MISSING = std::numeric_limits<double>::quiet_NaN();
constexpr double RAD_PER_DEG = 3.14159265358979323846 / 180;

// The newest value since the last call of take; NaN if there was none.
class Newest {
public:
    void add(double value) { value_ = value; }

    double take()
    {
        const double value = value_;
        value_ = MISSING;
        return value;
    }

private:
    double value_ = MISSING;
};

// The mean of the finite values since the last call of take; NaN if there was none.
class Mean {
public:
    void add(double value)
    {
        if (std::isfinite(value)) {
            sum_ += value;
            count_++;
        }
    }

    double take()
    {
        const double mean = count_ ? sum_ / count_ : MISSING;
        sum_ = 0;
        count_ = 0;
        return mean;
    }

private:
    double sum_ = 0;
    int count_ = 0;
};

// Metres east and north of an origin: geocentric coordinates (WGS 84) on the tangent plane, as
// rhec.logs.read computes them.
class TangentPlane {
public:
    // NaN for the latitude or the longitude: the first position becomes the origin.
    TangentPlane(double latitude_deg, double longitude_deg, double altitude_m)
    {
        if (std::isfinite(latitude_deg) && std::isfinite(longitude_deg)) {
            set_origin(latitude_deg, longitude_deg, altitude_m);
        }
    }

    void project(double latitude_deg, double longitude_deg, double altitude_m, double &x_m,
                 double &y_m)
    {
        if (!has_origin_) {
            set_origin(latitude_deg, longitude_deg, altitude_m);
        }
        const double turned = (longitude_deg - longitude_deg_) * RAD_PER_DEG;
        double from_axis, above_equator;
        geocentric(latitude_deg * RAD_PER_DEG, altitude_m, from_axis, above_equator);
        const double out = from_axis * std::cos(turned) - from_axis_;
        const double up = above_equator - above_equator_;
        x_m = from_axis * std::sin(turned);
        y_m = up * std::cos(phi_) - out * std::sin(phi_);
    }

private:
    static void geocentric(double phi, double altitude_m, double &from_axis, double &above_equator)
    {
        constexpr double axis_m = 6378137.0, eccentricity_2 = 6.69437999014e-3;
        const double sine = std::sin(phi);
        const double normal = axis_m / std::sqrt(1 - eccentricity_2 * sine * sine);
        const double height = std::isfinite(altitude_m) ? altitude_m : 0;
        from_axis = (normal + height) * std::cos(phi);
        above_equator = (normal * (1 - eccentricity_2) + height) * sine;
    }

    void set_origin(double latitude_deg, double longitude_deg, double altitude_m)
    {
        phi_ = latitude_deg * RAD_PER_DEG;
        longitude_deg_ = longitude_deg;
        geocentric(phi_, altitude_m, from_axis_, above_equator_);
        has_origin_ = true;
    }

    bool has_origin_ = false;
    double phi_ = 0, longitude_deg_ = 0, from_axis_ = 0, above_equator_ = 0;
};

// Yaw [rad] of a quaternion of any length; NaN for one of length 0.
inline double yaw_of(double x, double y, double z, double w)
{
    const double sine = 2 * (w * z + x * y), cosine = w * w + x * x - y * y - z * z;
    return sine == 0 && cosine == 0 ? MISSING : std::atan2(sine, cosine);
}

} // namespace rhec_ros2

#endif
