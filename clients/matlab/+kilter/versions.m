function list = versions(robot)
% VERSIONS  The versions of a robot, newest first.
found = kilter.internal.fetch(['/v1/robots/' kilter.internal.quote(robot) '/versions']);
list = found.versions;
end
