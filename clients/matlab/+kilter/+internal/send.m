function document = send(path, body)
% SEND  Send a struct as JSON and return the answer as a struct.
if nargin < 2
    text = '{}';
else
    text = jsonencode(body);
end
document = jsondecode(kilter.internal.request('POST', path, text));
end
