// What kilter_controller uses of pluginlib, written for its test: the class is made by name.
#ifndef PLUGINLIB_CLASS_LIST_MACROS_HPP
#define PLUGINLIB_CLASS_LIST_MACROS_HPP
#define PLUGINLIB_EXPORT_CLASS(CLASS, BASE) \
    BASE *made_by_plugin() { return new CLASS; }
#endif
