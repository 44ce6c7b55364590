// What kilter_controller uses of ros2_control (Jazzy), written for its test: names and signatures, and the least behind them.
#ifndef CONTROLLER_INTERFACE_CHAINABLE_CONTROLLER_INTERFACE_HPP
#define CONTROLLER_INTERFACE_CHAINABLE_CONTROLLER_INTERFACE_HPP

#include <cstdio>
#include <map>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#define RCLCPP_ERROR(logger, ...) ((void)(logger), std::fprintf(stderr, __VA_ARGS__), std::fprintf(stderr, "\n"))
#define RCLCPP_INFO(logger, ...) RCLCPP_ERROR(logger, __VA_ARGS__)

namespace rclcpp {
struct Logger {};
class Time {};
class Duration {
public:
    explicit Duration(double seconds) : seconds_(seconds) {}
    double seconds() const { return seconds_; }

private:
    double seconds_;
};
struct Parameter {
    std::vector<std::string> strings;
    std::string text;
    double number = 0.0;
    std::vector<std::string> as_string_array() const { return strings; }
    std::string as_string() const { return text; }
    double as_double() const { return number; }
};
} // namespace rclcpp

namespace rclcpp_lifecycle {
class State {};
class LifecycleNode {
public:
    std::map<std::string, rclcpp::Parameter> parameters;
    rclcpp::Parameter get_parameter(const std::string &name) const { return parameters.at(name); }
    rclcpp::Logger get_logger() const { return {}; }
    const char *get_name() const { return "kilter_controller"; }
};
} // namespace rclcpp_lifecycle

namespace hardware_interface {
class CommandInterface {
public:
    CommandInterface(const std::string &prefix, const std::string &name, double *value)
        : prefix_(prefix), name_(name), value_(value) {}
    std::string get_name() const { return prefix_ + "/" + name_; }
    [[nodiscard]] bool set_value(double value)
    {
        *value_ = value;
        return true;
    }

private:
    std::string prefix_, name_;
    double *value_;
};
class LoanedCommandInterface {
public:
    explicit LoanedCommandInterface(CommandInterface &one) : one_(&one) {}
    [[nodiscard]] bool set_value(double value) { return one_->set_value(value); }

private:
    CommandInterface *one_;
};
class LoanedStateInterface {
public:
    explicit LoanedStateInterface(const double *value) : value_(value) {}
    double get_value() const { return *value_; }

private:
    const double *value_;
};
} // namespace hardware_interface

namespace controller_interface {
enum class CallbackReturn { SUCCESS, FAILURE, ERROR };
enum class return_type { OK, ERROR };
enum class interface_configuration_type { ALL, INDIVIDUAL, NONE };
struct InterfaceConfiguration {
    interface_configuration_type type;
    std::vector<std::string> names = {};
};

class ChainableControllerInterface {
public:
    virtual ~ChainableControllerInterface() = default;
    virtual CallbackReturn on_init() = 0;
    virtual CallbackReturn on_configure(const rclcpp_lifecycle::State &before) = 0;
    virtual CallbackReturn on_activate(const rclcpp_lifecycle::State &before) = 0;
    virtual CallbackReturn on_deactivate(const rclcpp_lifecycle::State &before) = 0;
    virtual InterfaceConfiguration command_interface_configuration() const = 0;
    virtual InterfaceConfiguration state_interface_configuration() const = 0;
    std::shared_ptr<rclcpp_lifecycle::LifecycleNode> get_node() const { return node_; }
    std::vector<hardware_interface::CommandInterface> export_reference_interfaces()
    {
        return on_export_reference_interfaces();
    }
    void assign_interfaces(std::vector<hardware_interface::LoanedCommandInterface> commands,
                           std::vector<hardware_interface::LoanedStateInterface> states)
    {
        command_interfaces_ = std::move(commands);
        state_interfaces_ = std::move(states);
    }
    return_type update(const rclcpp::Time &time, const rclcpp::Duration &period)
    {
        return update_and_write_commands(time, period);
    }

protected:
    template <typename T> T auto_declare(const std::string &name, const T &value)
    {
        node_->parameters.emplace(name, parameter(value));
        return value;
    }
    virtual std::vector<hardware_interface::CommandInterface> on_export_reference_interfaces() = 0;
    virtual return_type update_reference_from_subscribers(const rclcpp::Time &time, const rclcpp::Duration &period) = 0;
    virtual return_type update_and_write_commands(const rclcpp::Time &time, const rclcpp::Duration &period) = 0;

    std::vector<double> reference_interfaces_;
    std::vector<hardware_interface::LoanedCommandInterface> command_interfaces_;
    std::vector<hardware_interface::LoanedStateInterface> state_interfaces_;

private:
    static rclcpp::Parameter parameter(double value) { return {{}, "", value}; }
    static rclcpp::Parameter parameter(const std::string &value) { return {{}, value, 0.0}; }
    static rclcpp::Parameter parameter(const std::vector<std::string> &value) { return {value, "", 0.0}; }

    std::shared_ptr<rclcpp_lifecycle::LifecycleNode> node_ = std::make_shared<rclcpp_lifecycle::LifecycleNode>();
};
} // namespace controller_interface
#endif
