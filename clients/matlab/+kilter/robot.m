function document = robot(name)
% ROBOT  A robot: joints, limits, names of its parameters.
document = kilter.internal.fetch(['/v1/robots/' kilter.internal.quote(name)]);
end
