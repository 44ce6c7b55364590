// A chainable controller of ros2_control that corrects joint positions by the calibration of one arm.
//
// SPDX-License-Identifier: Apache-2.0
#ifndef KILTER_CONTROLLER_HPP
#define KILTER_CONTROLLER_HPP

#include "kilter_corrector.hpp"

#include <memory>
#include <string>
#include <vector>

#include "controller_interface/chainable_controller_interface.hpp"

namespace kilter_controller {

using controller_interface::CallbackReturn;

// Its references are JOINT/position of the wanted arm; it commands JOINT/position of the hardware.
class KilterController : public controller_interface::ChainableControllerInterface {
public:
    CallbackReturn on_init() override;
    CallbackReturn on_configure(const rclcpp_lifecycle::State &before) override;
    CallbackReturn on_activate(const rclcpp_lifecycle::State &before) override;
    CallbackReturn on_deactivate(const rclcpp_lifecycle::State &before) override;
    controller_interface::InterfaceConfiguration command_interface_configuration() const override;
    controller_interface::InterfaceConfiguration state_interface_configuration() const override;

protected:
    std::vector<hardware_interface::CommandInterface> on_export_reference_interfaces() override;
    controller_interface::return_type update_reference_from_subscribers(const rclcpp::Time &time,
                                                                        const rclcpp::Duration &period) override;
    controller_interface::return_type update_and_write_commands(const rclcpp::Time &time,
                                                                const rclcpp::Duration &period) override;

private:
    controller_interface::InterfaceConfiguration positions() const;
    void write(double share_of_last);

    std::unique_ptr<kilter::Corrector> correct_;
    std::vector<std::string> joints_;
    std::vector<double> corrected_, last_; // of the joints: what is commanded, and the last correction
    double hold_s_ = 0.1, fade_s_ = 1.0;
    double since_s_ = 0.0, dt_s_ = 0.0; // since the last answer that was OK
};

} // namespace kilter_controller
#endif
