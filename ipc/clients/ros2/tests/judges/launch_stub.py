"""Stands for ROS 2's `launch`, as far as a launch file uses it, and prints what would be started."""

import os
import runpy
import sys
import types

declared = {"domain": "/run/x"}


def declare(name, default_value=None, description=None):
    declared.setdefault(name, default_value)


def execute(cmd, name, output):
    assert name in cmd and output == "screen"
    return [word if isinstance(word, str) else word() for word in cmd]


modules = {
    "launch": {"LaunchDescription": list},
    "launch.actions": {"DeclareLaunchArgument": declare, "ExecuteProcess": execute},
    "launch.substitutions": {
        "LaunchConfiguration": lambda name: lambda: declared[name],
        "EnvironmentVariable": lambda name, default_value: lambda: os.environ.get(name, default_value),
    },
}
for name, content in modules.items():
    sys.modules[name] = types.ModuleType(name)
    vars(sys.modules[name]).update(content)
for command in runpy.run_path(sys.argv[1])["generate_launch_description"]():
    if command:
        print(*command)
