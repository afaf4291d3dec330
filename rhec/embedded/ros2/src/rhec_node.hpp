// SPDX-License-Identifier: MIT
// A node that estimates and steers a tracked robot on the path of the exported scenario.
//
// Messages only store what a sensor measured. A timer of RHEC_DT_S takes what came since its last
// call, with NaN for what did not come, computes the estimate and the command, publishes them, and
// prepares the next sample. The computation takes no memory from the heap and returns in bounded
// time for any numbers (rhec.h).
#ifndef RHEC_ROS2_RHEC_NODE_HPP
#define RHEC_ROS2_RHEC_NODE_HPP

#include <cmath>
#include <cstddef>
#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

#include <diagnostic_msgs/msg/diagnostic_array.hpp>
#include <geometry_msgs/msg/pose_with_covariance_stamped.hpp>
#include <geometry_msgs/msg/twist_stamped.hpp>
#include <nav_msgs/msg/odometry.hpp>
#include <rclcpp/rclcpp.hpp>
#include <sensor_msgs/msg/imu.hpp>
#include <sensor_msgs/msg/joint_state.hpp>
#include <sensor_msgs/msg/nav_sat_fix.hpp>
#include <std_msgs/msg/bool.hpp>

#include "outputs.hpp" // generated: places of sensors and of the covariance, and the speed
#include "rhec.h"
#include "samples.hpp"

namespace rhec_ros2 {

class RhecNode : public rclcpp::Node {
public:
    explicit RhecNode(const rclcpp::NodeOptions &options = rclcpp::NodeOptions())
        : rclcpp::Node("rhec_node", options),
          plane_(number("origin_latitude_deg", MISSING), number("origin_longitude_deg", MISSING),
                 number("origin_altitude_m", MISSING))
    {
        read_parameters();
        subscribe();
        command_publisher_ = create_publisher<geometry_msgs::msg::TwistStamped>("cmd_vel", 10);
        pose_publisher_ =
            create_publisher<geometry_msgs::msg::PoseWithCovarianceStamped>("~/pose", 10);
        diagnostics_publisher_ =
            create_publisher<diagnostic_msgs::msg::DiagnosticArray>("/diagnostics", 10);
        const auto period = rclcpp::Duration::from_seconds(RHEC_DT_S);
        timer_ = rclcpp::create_timer(this, get_clock(), period, [this] { step(); });
    }

private:
    double number(const std::string &name, double value)
    {
        return declare_parameter<double>(name, value);
    }

    // Whether the parameter has the second of the two words that it may have.
    bool is_second(const std::string &name, const std::string &first, const std::string &second)
    {
        const auto word = declare_parameter<std::string>(name, first);
        if (word != first && word != second) {
            throw std::invalid_argument(name + " was '" + word + "'; it should be '" + first +
                                        "' or '" + second + "'");
        }
        return word == second;
    }

    double positive(const std::string &name, double value)
    {
        const double given = number(name, value);
        if (!(given > 0) || !std::isfinite(given)) {
            throw std::invalid_argument(name + " was " + std::to_string(given) +
                                        "; it should be above 0");
        }
        return given;
    }

    double finite(const std::string &name, double value)
    {
        const double given = number(name, value);
        if (!std::isfinite(given)) {
            throw std::invalid_argument(name + " was " + std::to_string(given) +
                                        "; it should be finite");
        }
        return given;
    }

    void read_parameters()
    {
        is_enabled_ = declare_parameter<bool>("enabled", false);
        starts_as_in_scenario_ = is_second("start", "first_position", "scenario");
        has_fix_ = is_second("position", "odometry", "fix");
        has_joints_ = is_second("encoders", "odometry", "joint_states");
        initial_yaw_rad_ = finite("initial_yaw_rad", rhec_scenario_guess[2]);
        speed_mps_ = finite("speed_mps", SPEED_MPS);
        stop_after_s_ = positive("stop_after_s", 2.0);
        left_joint_ = declare_parameter<std::string>("left_joint", "left_wheel_joint");
        right_joint_ = declare_parameter<std::string>("right_joint", "right_wheel_joint");
        wheel_radius_m_ = positive("wheel_radius_m", 0.1);
        track_width_m_ = positive("track_width_m", 0.4);
        pose_.header.frame_id = declare_parameter<std::string>("map_frame", "map");
        command_.header.frame_id = declare_parameter<std::string>("base_frame", "base_link");
    }

    template <typename Message, typename Receive> void listen(const char *topic, Receive receive)
    {
        auto callback = [receive](std::shared_ptr<const Message> message) { receive(*message); };
        subscriptions_.push_back(
            create_subscription<Message>(topic, rclcpp::SensorDataQoS(), callback));
    }

    void subscribe()
    {
        if (has_fix_) {
            listen<sensor_msgs::msg::NavSatFix>("position", [this](const auto &m) { on_fix(m); });
        } else {
            listen<nav_msgs::msg::Odometry>("position", [this](const auto &message) {
                x_.add(message.pose.pose.position.x);
                y_.add(message.pose.pose.position.y);
            });
        }
        if (has_joints_) {
            listen<sensor_msgs::msg::JointState>("encoders",
                                                 [this](const auto &m) { on_joints(m); });
        } else {
            listen<nav_msgs::msg::Odometry>("encoders", [this](const auto &message) {
                nu_.add(message.twist.twist.linear.x);
                omega_.add(message.twist.twist.angular.z);
            });
        }
        if (GYRO >= 0 || HEADING >= 0) {
            listen<sensor_msgs::msg::Imu>("imu", [this](const auto &m) { on_imu(m); });
        }
        listen<std_msgs::msg::Bool>("~/enable", [this](const auto &m) { is_enabled_ = m.data; });
    }

    void on_fix(const sensor_msgs::msg::NavSatFix &fix)
    {
        const bool is_valid = fix.status.status >= 0 && std::abs(fix.latitude) <= 90 &&
                              std::abs(fix.longitude) <= 360;
        // A receiver without a fix may send 0, 0.
        if (!is_valid || (fix.latitude == 0 && fix.longitude == 0)) {
            return;
        }
        double x_m, y_m;
        plane_.project(fix.latitude, fix.longitude, fix.altitude, x_m, y_m);
        x_.add(x_m);
        y_.add(y_m);
    }

    void on_joints(const sensor_msgs::msg::JointState &joints)
    {
        double left = MISSING, right = MISSING;
        for (std::size_t i = 0; i < joints.name.size() && i < joints.velocity.size(); i++) {
            if (joints.name[i] == left_joint_) {
                left = joints.velocity[i] * wheel_radius_m_;
            } else if (joints.name[i] == right_joint_) {
                right = joints.velocity[i] * wheel_radius_m_;
            }
        }
        nu_.add((left + right) / 2);
        omega_.add((right - left) / track_width_m_);
    }

    // An Imu that does not measure something says so by a covariance of -1.
    void on_imu(const sensor_msgs::msg::Imu &imu)
    {
        if (imu.angular_velocity_covariance[0] != -1) {
            gyro_.add(imu.angular_velocity.z);
        }
        if (imu.orientation_covariance[0] != -1) {
            const auto &q = imu.orientation;
            heading_.add(yaw_of(q.x, q.y, q.z, q.w));
        }
    }

    void take(double z[RHEC_OUTPUTS])
    {
        const double gyro_radps = gyro_.take(), heading_rad = heading_.take();
        z[0] = x_.take();
        z[1] = y_.take();
        z[2] = nu_.take();
        z[3] = omega_.take();
        for (int i = 4; i < RHEC_OUTPUTS; i++) {
            z[i] = i == GYRO ? gyro_radps : i == HEADING ? heading_rad : MISSING;
        }
    }

    // Starts the estimator, as soon as there is a position to start at. Returns whether it runs.
    bool start(const double z[RHEC_OUTPUTS])
    {
        double guess[RHEC_GUESS];
        for (int i = 0; i < RHEC_GUESS; i++) {
            guess[i] = rhec_scenario_guess[i];
        }
        if (!starts_as_in_scenario_) {
            if (!std::isfinite(z[0]) || !std::isfinite(z[1])) {
                return false;
            }
            const double heading_rad = HEADING >= 0 ? z[HEADING < 0 ? 0 : HEADING] : MISSING;
            guess[0] = z[0];
            guess[1] = z[1];
            guess[2] = std::isfinite(heading_rad) ? heading_rad : initial_yaw_rad_;
            guess[3] = 0;
        }
        rhec_init(&robot_, &rhec_scenario, guess);
        return true;
    }

    void step()
    {
        double z[RHEC_OUTPUTS], estimate[RHEC_ESTIMATE], omega;
        take(z);
        if (!is_started_ && !(is_started_ = start(z))) {
            return;
        }
        int status = rhec_estimate(&robot_, z, estimate);
        status |= rhec_control(&robot_, &omega);
        const bool has_position = std::isfinite(z[0]) && std::isfinite(z[1]);
        const bool sees = has_position && !(status & RHEC_PREDICTED);
        blind_samples_ = sees ? 0 : blind_samples_ + 1;
        publish(estimate, omega, status);
        rhec_prepare_estimate(&robot_);
        rhec_prepare_control(&robot_);
    }

    bool may_drive() const
    {
        const bool is_blind = blind_samples_ * RHEC_DT_S > stop_after_s_;
        const bool is_at_end = IS_OPEN && robot_.path.s[0] >= LENGTH_M;
        return is_enabled_ && !is_blind && !is_at_end;
    }

    void publish(const double estimate[RHEC_ESTIMATE], double omega, int status)
    {
        const auto stamp = now();
        const bool drives = may_drive();
        command_.header.stamp = stamp;
        command_.twist.linear.x = drives ? commanded_speed(robot_, speed_mps_) : 0;
        command_.twist.angular.z = drives ? omega : 0;
        command_publisher_->publish(command_);

        auto &pose = pose_.pose.pose;
        pose_.header.stamp = stamp;
        pose.position.x = estimate[0];
        pose.position.y = estimate[1];
        pose.orientation.z = std::sin(estimate[2] / 2);
        pose.orientation.w = std::cos(estimate[2] / 2);
        write_covariance(robot_, pose_.pose.covariance);
        pose_publisher_->publish(pose_);
        publish_diagnostics(stamp, estimate, drives, status);
    }

    void publish_diagnostics(const rclcpp::Time &stamp, const double estimate[RHEC_ESTIMATE],
                             bool drives, int status)
    {
        using Status = diagnostic_msgs::msg::DiagnosticStatus;
        diagnostics_.header.stamp = stamp;
        diagnostics_.status.resize(1);
        auto &report = diagnostics_.status[0];
        report.level = status ? Status::WARN : Status::OK;
        report.name = "rhec_node";
        report.message = status & RHEC_ESTIMATOR_RESTARTED  ? "the estimator restarted"
                         : status & RHEC_PREDICTED          ? "no plausible measurement"
                         : status & RHEC_CONTROLLER_RESTARTED ? "the controller restarted"
                         : status & RHEC_AS_PLANNED         ? "the command is that of the last plan"
                         : drives                           ? "drives"
                                                            : "stands";
        const char *names[] = {"nu_mps", "mu", "kappa"};
        report.values.resize(3);
        for (int i = 0; i < 3; i++) {
            report.values[i].key = names[i];
            report.values[i].value = std::to_string(estimate[3 + i]);
        }
        diagnostics_publisher_->publish(diagnostics_);
    }

    bool is_enabled_ = false;
    bool is_started_ = false;
    bool starts_as_in_scenario_ = false;
    bool has_fix_ = false;
    bool has_joints_ = false;
    int blind_samples_ = 0;
    double initial_yaw_rad_ = 0, speed_mps_ = 0, stop_after_s_ = 0;
    double wheel_radius_m_ = 0, track_width_m_ = 0;
    std::string left_joint_, right_joint_;
    TangentPlane plane_;
    Newest x_, y_, heading_;
    Mean nu_, omega_, gyro_;
    struct ::rhec robot_ {};

    geometry_msgs::msg::TwistStamped command_;
    geometry_msgs::msg::PoseWithCovarianceStamped pose_;
    diagnostic_msgs::msg::DiagnosticArray diagnostics_;
    std::vector<rclcpp::SubscriptionBase::SharedPtr> subscriptions_;
    rclcpp::Publisher<geometry_msgs::msg::TwistStamped>::SharedPtr command_publisher_;
    rclcpp::Publisher<geometry_msgs::msg::PoseWithCovarianceStamped>::SharedPtr pose_publisher_;
    rclcpp::Publisher<diagnostic_msgs::msg::DiagnosticArray>::SharedPtr diagnostics_publisher_;
    rclcpp::TimerBase::SharedPtr timer_;
};

} // namespace rhec_ros2

#endif
