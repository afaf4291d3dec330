// What rhec_node uses of rclcpp, for tests on machines without ROS 2: topics are calls, parameters
// and time are global, and a program fires the timer itself.
#pragma once

#include <cmath>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <string>

#include "messages.hpp"

namespace rclcpp {

struct World {
    std::map<std::string, std::string> parameters; // as in a YAML file, by name
    std::map<std::string, std::function<void(const void *)>> subscribers, watchers; // by topic
    std::function<void()> timer;
    int64_t now_ns = 0;
};

inline World world;

class Duration {
public:
    static Duration from_seconds(double seconds) { return Duration(std::llround(1e9 * seconds)); }
    int64_t nanoseconds() const { return ns_; }

private:
    explicit Duration(int64_t ns) : ns_(ns) {}
    int64_t ns_;
};

class Time {
public:
    explicit Time(int64_t ns) : ns_(ns) {}
    operator builtin_interfaces::msg::Time() const
    {
        return {int32_t(ns_ / 1000000000), uint32_t(ns_ % 1000000000)};
    }

private:
    int64_t ns_;
};

struct Clock {
    using SharedPtr = std::shared_ptr<Clock>;
};

struct TimerBase {
    using SharedPtr = std::shared_ptr<TimerBase>;
};

struct SubscriptionBase {
    using SharedPtr = std::shared_ptr<SubscriptionBase>;
};

struct QoS {
    QoS(int) {}
};

struct SensorDataQoS : QoS {
    SensorDataQoS() : QoS(5) {}
};

struct NodeOptions {
};

template <typename Message> class Publisher {
public:
    using SharedPtr = std::shared_ptr<Publisher>;
    explicit Publisher(std::string topic) : topic_(topic) {}
    void publish(const Message &message)
    {
        auto watcher = world.watchers.find(topic_);
        if (watcher != world.watchers.end()) {
            watcher->second(&message);
        }
    }

private:
    std::string topic_;
};

inline void parse(const std::string &text, double &value) { value = std::stod(text); }
inline void parse(const std::string &text, bool &value) { value = text == "true"; }
inline void parse(const std::string &text, std::string &value) { value = text; }

class Node {
public:
    explicit Node(const std::string &, const NodeOptions &) {}

    template <typename Value> Value declare_parameter(const std::string &name, const Value &value)
    {
        Value given = value;
        auto found = world.parameters.find(name);
        if (found != world.parameters.end()) {
            parse(found->second, given);
        }
        return given;
    }

    template <typename Message>
    SubscriptionBase::SharedPtr
    create_subscription(const std::string &topic, const QoS &,
                        std::function<void(std::shared_ptr<const Message>)> callback)
    {
        world.subscribers[topic] = [callback](const void *message) {
            callback(std::make_shared<const Message>(*static_cast<const Message *>(message)));
        };
        return std::make_shared<SubscriptionBase>();
    }

    template <typename Message>
    typename Publisher<Message>::SharedPtr create_publisher(const std::string &topic, const QoS &)
    {
        return std::make_shared<Publisher<Message>>(topic);
    }

    Clock::SharedPtr get_clock() { return std::make_shared<Clock>(); }
    Time now() const { return Time(world.now_ns); }
};

inline TimerBase::SharedPtr create_timer(Node *, Clock::SharedPtr, Duration,
                                         std::function<void()> callback)
{
    world.timer = callback;
    return std::make_shared<TimerBase>();
}

inline void init(int, char **) {}
inline void spin(std::shared_ptr<Node>) {}
inline void shutdown() {}

} // namespace rclcpp
