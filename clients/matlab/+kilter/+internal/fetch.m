function document = fetch(path)
% FETCH  The JSON document at PATH as a struct.
document = jsondecode(kilter.internal.request('GET', path));
end
