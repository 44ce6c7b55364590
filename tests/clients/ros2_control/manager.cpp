// Stands for the controller manager: configures, activates, gives references from lines of numbers, prints commands.
//
//     manager PROGRAM JOINTS CYCLE_S < wanted.txt > commanded.txt
#include "controller_interface/chainable_controller_interface.hpp"

#include <cstdlib>
#include <iostream>
#include <iterator>
#include <sstream>

controller_interface::ChainableControllerInterface *made_by_plugin();

using controller_interface::CallbackReturn;

int main(int, char **arguments)
{
    const std::unique_ptr<controller_interface::ChainableControllerInterface> controller(made_by_plugin());
    const std::size_t joints = std::strtoul(arguments[2], nullptr, 10);
    const rclcpp_lifecycle::State state;
    controller->on_init();
    auto &parameters = controller->get_node()->parameters;
    parameters.at("program").text = arguments[1];
    for (std::size_t i = 1; i <= joints; i++) {
        parameters.at("joints").strings.push_back("joint_" + std::to_string(i));
    }
    if (controller->on_configure(state) != CallbackReturn::SUCCESS) {
        return 1;
    }
    std::vector<double> commanded(joints, -7.0), measured(joints, 0.0);
    std::vector<hardware_interface::CommandInterface> hardware;
    for (std::size_t i = 0; i < joints; i++) {
        hardware.emplace_back("hardware", controller->command_interface_configuration().names[i], &commanded[i]);
    }
    std::vector<hardware_interface::LoanedCommandInterface> commands(hardware.begin(), hardware.end());
    std::vector<hardware_interface::LoanedStateInterface> states;
    for (double &value : measured) {
        states.emplace_back(&value);
    }
    auto references = controller->export_reference_interfaces();
    for (const auto &reference : references) {
        std::cerr << reference.get_name() << "\n";
    }
    controller->assign_interfaces(commands, states);
    std::string line;
    for (bool active = false; std::getline(std::cin, line);) {
        std::istringstream numbers(line);
        std::vector<std::string> words((std::istream_iterator<std::string>(numbers)), {});
        for (std::size_t i = 0; !active && i < joints; i++) {
            measured[i] = std::strtod(words[i].c_str(), nullptr);
        }
        if (!active && controller->on_activate(state) != CallbackReturn::SUCCESS) {
            return 1;
        }
        active = true;
        for (std::size_t i = 0; i < joints; i++) {
            (void)references[i].set_value(std::strtod(words[i].c_str(), nullptr));
        }
        controller->update({}, rclcpp::Duration(std::atof(arguments[3])));
        for (std::size_t i = 0; i < joints; i++) {
            std::printf("%.17g%c", commanded[i], i + 1 < joints ? ' ' : '\n');
        }
    }
    controller->on_deactivate(state);
    return 0;
}
