// Drives rhec_node over a table: drive name=value … < table.csv > answers.csv
//
// Each line of the table is a call of the timer: x, y, nu, omega, gyro, heading; what is nan is not
// sent. With repeat=N, each message of speeds comes N times. With nonsense=1, broken messages come
// before lines 50 to 59 as well.
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <iostream>
#include <sstream>

#include "rhec_node.hpp"

using rclcpp::world;

template <typename Message> static void send(const char *topic, const Message &message)
{
    auto found = world.subscribers.find(topic);
    if (found != world.subscribers.end()) {
        found->second(&message);
    }
}

static void send_position(const double *z)
{
    if (std::isnan(z[0]) && std::isnan(z[1])) {
        return;
    }
    if (world.parameters["position"] == "fix") {
        sensor_msgs::msg::NavSatFix fix;
        fix.status.status = 0;
        fix.latitude = z[0];
        fix.longitude = z[1];
        send("position", fix);
        return;
    }
    nav_msgs::msg::Odometry odometry;
    odometry.pose.pose.position.x = z[0];
    odometry.pose.pose.position.y = z[1];
    send("position", odometry);
}

static void send_speeds(const double *z)
{
    if (std::isnan(z[2]) && std::isnan(z[3])) {
        return;
    }
    if (world.parameters["encoders"] == "joint_states") {
        const double radius = std::stod(world.parameters["wheel_radius_m"]);
        const double width = std::stod(world.parameters["track_width_m"]);
        sensor_msgs::msg::JointState joints;
        joints.name = {"other", "right_wheel_joint", "left_wheel_joint"};
        joints.velocity = {9.0, (z[2] + z[3] * width / 2) / radius,
                           (z[2] - z[3] * width / 2) / radius};
        send("encoders", joints);
        return;
    }
    nav_msgs::msg::Odometry odometry;
    odometry.twist.twist.linear.x = z[2];
    odometry.twist.twist.angular.z = z[3];
    send("encoders", odometry);
}

static void send_imu(const double *z)
{
    sensor_msgs::msg::Imu imu;
    imu.angular_velocity.z = z[4];
    imu.angular_velocity_covariance[0] = std::isnan(z[4]) ? -1 : 0;
    imu.orientation.z = 3 * std::sin(z[5] / 2); // of another length than 1
    imu.orientation.w = 3 * std::cos(z[5] / 2);
    imu.orientation_covariance[0] = std::isnan(z[5]) ? -1 : 0;
    send("imu", imu);
}

// Messages that no driver should send, and some do.
static void send_nonsense()
{
    if (world.parameters["encoders"] == "joint_states") {
        sensor_msgs::msg::JointState joints;
        joints.name = {"left_wheel_joint", "right_wheel_joint"};
        joints.velocity = {1.0}; // shorter than the names
        send("encoders", joints);
    }
    if (world.parameters["position"] == "fix") {
        sensor_msgs::msg::NavSatFix fix; // without a fix
        fix.latitude = fix.longitude = NAN;
        send("position", fix);
    }
    const double absurd[] = {NAN, INFINITY, -1e300, 1e300};
    for (const double value : absurd) {
        double z[] = {value, value, value, -value};
        send_position(z);
        send_speeds(z);
    }
    sensor_msgs::msg::Imu imu;
    imu.orientation.w = 0; // no direction
    imu.angular_velocity.z = INFINITY;
    send("imu", imu);
}

static void print(double number) { std::printf("%.17g,", number); }

int main(int argc, char **argv)
{
    for (int i = 1; i < argc; i++) {
        const std::string word = argv[i];
        const auto sign = word.find('=');
        world.parameters[word.substr(0, sign)] = word.substr(sign + 1);
    }
    geometry_msgs::msg::TwistStamped command;
    geometry_msgs::msg::PoseWithCovarianceStamped pose;
    diagnostic_msgs::msg::DiagnosticArray diagnostics;
    bool is_published = false;
    world.watchers["cmd_vel"] = [&](const void *message) {
        command = *static_cast<const geometry_msgs::msg::TwistStamped *>(message);
        is_published = true;
    };
    world.watchers["~/pose"] = [&](const void *message) {
        pose = *static_cast<const geometry_msgs::msg::PoseWithCovarianceStamped *>(message);
    };
    world.watchers["/diagnostics"] = [&](const void *message) {
        diagnostics = *static_cast<const diagnostic_msgs::msg::DiagnosticArray *>(message);
    };
    std::unique_ptr<rhec_ros2::RhecNode> node;
    try {
        node = std::make_unique<rhec_ros2::RhecNode>();
    } catch (const std::invalid_argument &error) {
        std::fprintf(stderr, "%s\n", error.what());
        return 2;
    }
    const int repeat = world.parameters.count("repeat") ? std::stoi(world.parameters["repeat"]) : 1;
    std::puts("published,x,y,yaw,variance_x,variance_yaw,nu,omega,status,mu,time_ns");
    std::string line;
    for (int row = 0; std::getline(std::cin, line); row++) {
        double z[6] = {NAN, NAN, NAN, NAN, NAN, NAN};
        std::istringstream fields(line);
        std::string field;
        for (int i = 0; i < 6 && std::getline(fields, field, ','); i++) {
            z[i] = field.empty() ? NAN : std::strtod(field.c_str(), nullptr);
        }
        if (world.parameters.count("nonsense") && row >= 50 && row < 60) {
            send_nonsense();
        }
        send_position(z);
        for (int i = 0; i < repeat; i++) {
            send_speeds(z);
        }
        send_imu(z);
        is_published = false;
        const auto begin = std::chrono::steady_clock::now();
        world.timer();
        const auto end = std::chrono::steady_clock::now();
        world.now_ns += std::llround(1e9 * RHEC_DT_S);
        const auto &q = pose.pose.pose.orientation;
        print(is_published);
        print(pose.pose.pose.position.x);
        print(pose.pose.pose.position.y);
        print(2 * std::atan2(q.z, q.w));
        print(pose.pose.covariance[0]);
        print(pose.pose.covariance[35]);
        print(command.twist.linear.x);
        print(command.twist.angular.z);
        print(diagnostics.status.empty() ? 0 : diagnostics.status[0].level);
        print(diagnostics.status.empty() ? NAN : std::stod(diagnostics.status[0].values[1].value));
        using std::chrono::duration_cast;
        std::printf("%lld\n", static_cast<long long>(
                                  duration_cast<std::chrono::nanoseconds>(end - begin).count()));
    }
    return 0;
}
