// A chainable controller of ros2_control that corrects joint positions by the calibration of one arm.
//
// SPDX-License-Identifier: Apache-2.0
#include "kilter_controller.hpp"

#include <algorithm>
#include <cmath>
#include <exception>

#include "pluginlib/class_list_macros.hpp"

namespace kilter_controller {

using controller_interface::InterfaceConfiguration;
using controller_interface::interface_configuration_type;
using controller_interface::return_type;

namespace {

const char POSITION[] = "position";

// After a refusal the last correction is held, and then faded out: no step, and no arm left waiting.
double share_of_last(double since_s, double hold_s, double fade_s)
{
    if (since_s <= hold_s) {
        return 1.0;
    }
    const double part = (since_s - hold_s) / fade_s;
    return part >= 1.0 ? 0.0 : 1.0 - part * part * (3.0 - 2.0 * part);
}

} // namespace

CallbackReturn KilterController::on_init()
{
    auto_declare<std::vector<std::string>>("joints", {});
    auto_declare<std::string>("program", "");
    auto_declare<double>("hold_s", hold_s_);
    auto_declare<double>("fade_s", fade_s_);
    return CallbackReturn::SUCCESS;
}

CallbackReturn KilterController::on_configure(const rclcpp_lifecycle::State &)
{
    const auto node = get_node();
    joints_ = node->get_parameter("joints").as_string_array();
    hold_s_ = node->get_parameter("hold_s").as_double();
    fade_s_ = node->get_parameter("fade_s").as_double();
    const std::string file = node->get_parameter("program").as_string();
    if (!(hold_s_ >= 0.0) || !(fade_s_ > 0.0)) {
        RCLCPP_ERROR(node->get_logger(), "hold_s must not be negative, and fade_s must be positive.");
        return CallbackReturn::ERROR;
    }
    try {
        correct_ = std::make_unique<kilter::Corrector>(kilter::read_program(file));
    } catch (const std::exception &error) {
        RCLCPP_ERROR(node->get_logger(), "program %s: %s", file.c_str(), error.what());
        return CallbackReturn::ERROR;
    }
    if (joints_.size() != correct_->joints()) {
        RCLCPP_ERROR(node->get_logger(), "joints names %zu, the program %s is of an arm with %zu.", joints_.size(),
                     file.c_str(), correct_->joints());
        return CallbackReturn::ERROR;
    }
    corrected_.assign(joints_.size(), 0.0);
    last_.assign(joints_.size(), 0.0);
    RCLCPP_INFO(node->get_logger(), "corrects %s by version %s", correct_->robot().c_str(), correct_->version().c_str());
    return CallbackReturn::SUCCESS;
}

InterfaceConfiguration KilterController::positions() const
{
    InterfaceConfiguration wanted{interface_configuration_type::INDIVIDUAL, {}};
    for (const std::string &joint : joints_) {
        wanted.names.push_back(joint + "/" + POSITION);
    }
    return wanted;
}

InterfaceConfiguration KilterController::command_interface_configuration() const { return positions(); }

InterfaceConfiguration KilterController::state_interface_configuration() const { return positions(); }

std::vector<hardware_interface::CommandInterface> KilterController::on_export_reference_interfaces()
{
    reference_interfaces_.assign(joints_.size(), std::nan(""));
    std::vector<hardware_interface::CommandInterface> references;
    references.reserve(joints_.size());
    for (std::size_t i = 0; i < joints_.size(); i++) {
        references.emplace_back(get_node()->get_name(), joints_[i] + "/" + POSITION, &reference_interfaces_[i]);
    }
    return references;
}

CallbackReturn KilterController::on_activate(const rclcpp_lifecycle::State &)
{
    correct_->restart(); // the correction ramps in from where the arm is
    std::fill(last_.begin(), last_.end(), 0.0);
    for (std::size_t i = 0; i < joints_.size(); i++) {
        reference_interfaces_[i] = state_interfaces_[i].get_value();
    }
    since_s_ = dt_s_ = 0.0;
    return CallbackReturn::SUCCESS;
}

CallbackReturn KilterController::on_deactivate(const rclcpp_lifecycle::State &)
{
    std::fill(reference_interfaces_.begin(), reference_interfaces_.end(), std::nan(""));
    return CallbackReturn::SUCCESS;
}

// Without a controller before it nobody gives a reference: the last one stays.
return_type KilterController::update_reference_from_subscribers(const rclcpp::Time &, const rclcpp::Duration &)
{
    return return_type::OK;
}

void KilterController::write(double share)
{
    for (std::size_t i = 0; i < joints_.size(); i++) {
        (void)command_interfaces_[i].set_value(reference_interfaces_[i] + share * last_[i]);
    }
}

return_type KilterController::update_and_write_commands(const rclcpp::Time &, const rclcpp::Duration &period)
{
    const bool given = std::none_of(reference_interfaces_.begin(), reference_interfaces_.end(),
                                    [](double q) { return !std::isfinite(q); });
    if (!given) {
        return return_type::OK; // the hardware keeps its last command
    }
    dt_s_ += period.seconds();
    const int status = (*correct_)(reference_interfaces_.data(), dt_s_, corrected_.data());
    if (status == KC_OK) {
        for (std::size_t i = 0; i < joints_.size(); i++) {
            last_[i] = corrected_[i] - reference_interfaces_[i];
        }
        since_s_ = dt_s_ = 0.0;
        write(1.0);
    } else {
        since_s_ += period.seconds();
        write(share_of_last(since_s_, hold_s_, fade_s_));
    }
    return return_type::OK;
}

} // namespace kilter_controller

PLUGINLIB_EXPORT_CLASS(kilter_controller::KilterController, controller_interface::ChainableControllerInterface)
