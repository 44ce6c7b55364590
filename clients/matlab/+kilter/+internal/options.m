function [options, validation] = options(given)
% OPTIONS  Name and value pairs as a struct of job options; 'validation' is taken out.
if mod(numel(given), 2) ~= 0
    error('kilter:usage', 'Give options as pairs of name and value.');
end
options = struct();
validation = [];
for k = 1:2:numel(given)
    if strcmp(given{k}, 'validation')
        validation = given{k + 1};
    else
        options.(given{k}) = given{k + 1};
    end
end
end
