function list = robots()
% ROBOTS  All robots, by name.
found = kilter.internal.fetch('/v1/robots');
list = found.robots;
end
