// Linked after host.cpp: see begin.cpp.
alignas(64) char host_data_end[64] = {1};
alignas(64) char host_zeros_end[64];
