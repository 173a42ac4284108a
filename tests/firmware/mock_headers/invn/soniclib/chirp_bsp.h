// Declarations only (see soniclib.h beside it).
#pragma once
#include "soniclib.h"
void chbsp_board_init(ch_group_t*);
