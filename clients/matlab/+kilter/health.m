function document = health()
% HEALTH  State of the server and its checks.
document = kilter.internal.fetch('/v1/health');
end
