// SPDX-License-Identifier: MIT
#include <memory>

#include "rhec_node.hpp"

int main(int argc, char **argv)
{
    rclcpp::init(argc, argv);
    rclcpp::spin(std::make_shared<rhec_ros2::RhecNode>());
    rclcpp::shutdown();
    return 0;
}
