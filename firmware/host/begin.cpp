// Linked before host.cpp, whose variables then lie between these and those of end.cpp.
alignas(64) char host_data_begin[64] = {1};
alignas(64) char host_zeros_begin[64];
