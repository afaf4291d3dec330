// The fields of ROS 2's standard messages that rhec_node uses, with their types and defaults.
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <vector>

namespace builtin_interfaces::msg {
struct Time {
    int32_t sec = 0;
    uint32_t nanosec = 0;
};
} // namespace builtin_interfaces::msg

namespace std_msgs::msg {
struct Bool {
    bool data = false;
};
struct Header {
    builtin_interfaces::msg::Time stamp;
    std::string frame_id;
};
} // namespace std_msgs::msg

namespace geometry_msgs::msg {
struct Vector3 {
    double x = 0, y = 0, z = 0;
};
struct Quaternion {
    double x = 0, y = 0, z = 0, w = 1;
};
struct Pose {
    Vector3 position;
    Quaternion orientation;
};
struct PoseWithCovariance {
    Pose pose;
    std::array<double, 36> covariance{};
};
struct PoseWithCovarianceStamped {
    std_msgs::msg::Header header;
    PoseWithCovariance pose;
};
struct Twist {
    Vector3 linear, angular;
};
struct TwistWithCovariance {
    Twist twist;
    std::array<double, 36> covariance{};
};
struct TwistStamped {
    std_msgs::msg::Header header;
    Twist twist;
};
} // namespace geometry_msgs::msg

namespace nav_msgs::msg {
struct Odometry {
    std_msgs::msg::Header header;
    std::string child_frame_id;
    geometry_msgs::msg::PoseWithCovariance pose;
    geometry_msgs::msg::TwistWithCovariance twist;
};
} // namespace nav_msgs::msg

namespace sensor_msgs::msg {
struct NavSatStatus {
    int8_t status = -2;
    uint16_t service = 0;
};
struct NavSatFix {
    std_msgs::msg::Header header;
    NavSatStatus status;
    double latitude = 0, longitude = 0, altitude = 0;
    std::array<double, 9> position_covariance{};
    uint8_t position_covariance_type = 0;
};
struct Imu {
    std_msgs::msg::Header header;
    geometry_msgs::msg::Quaternion orientation;
    std::array<double, 9> orientation_covariance{};
    geometry_msgs::msg::Vector3 angular_velocity;
    std::array<double, 9> angular_velocity_covariance{};
    geometry_msgs::msg::Vector3 linear_acceleration;
    std::array<double, 9> linear_acceleration_covariance{};
};
struct JointState {
    std_msgs::msg::Header header;
    std::vector<std::string> name;
    std::vector<double> position, velocity, effort;
};
} // namespace sensor_msgs::msg

namespace diagnostic_msgs::msg {
struct KeyValue {
    std::string key, value;
};
struct DiagnosticStatus {
    static constexpr unsigned char OK = 0, WARN = 1, ERROR = 2, STALE = 3;
    unsigned char level = 0;
    std::string name, message, hardware_id;
    std::vector<KeyValue> values;
};
struct DiagnosticArray {
    std_msgs::msg::Header header;
    std::vector<DiagnosticStatus> status;
};
} // namespace diagnostic_msgs::msg
