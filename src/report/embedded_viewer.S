/* SPDX-License-Identifier: Apache-2.0 */
/* The bytes of model-viewer (Apache-2.0), for pages of `report`. */
    .section .rodata
    .global vdbcarve_viewer_begin
    .global vdbcarve_viewer_end
vdbcarve_viewer_begin:
    .incbin VDBCARVE_VIEWER_FILE
vdbcarve_viewer_end:
    .byte 0
    .section .note.GNU-stack,"",@progbits
