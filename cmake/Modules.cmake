# vdbcarve_module(NAME SOURCES… [API…] [SHARED…] [PUBLIC…] [PRIVATE…] [LIBRARIES…] [OPENVDB]): the sources of src/NAME become objects of the
# library. What it may include is what its links hand to it, and nothing else is on its include path:
#   API        headers of include/vdbcarve that belong to this module
#   SHARED     headers of src/NAME that other modules may include, as "NAME/x.h"; all others are private
#   PUBLIC     modules whose headers this one's headers include; whoever may use this one may use those
#   PRIVATE    modules that its sources alone use
#   LIBRARIES  of others, private
#   OPENVDB    its sources share the precompiled header
# Other modules see this one through a folder of links in the build, which holds nothing but its API and SHARED headers.
set_property(GLOBAL PROPERTY VDBCARVE_OBJECTS "")
set_property(GLOBAL PROPERTY VDBCARVE_LIBRARIES "")

# Links `name` of `folder` to `source`, unless it does already: a newer link would compile everything again.
function(vdbcarve_link folder name source)
  get_filename_component(parent ${folder}/${name} DIRECTORY)
  file(MAKE_DIRECTORY ${parent})
  file(RELATIVE_PATH target ${parent} ${source})
  if(IS_SYMLINK ${folder}/${name})
    file(READ_SYMLINK ${folder}/${name} was)
    if(was STREQUAL target)
      return()
    endif()
  endif()
  file(CREATE_LINK ${target} ${folder}/${name} SYMBOLIC)
endfunction()

# Removes links that are none of `names` any more.
function(vdbcarve_unlink_others folder names)
  file(GLOB_RECURSE found LIST_DIRECTORIES false RELATIVE ${folder} ${folder}/*)
  foreach(name ${found})
    if(NOT name IN_LIST names)
      file(REMOVE ${folder}/${name})
    endif()
  endforeach()
endfunction()

# The precompiled header, once for all modules that include OpenVDB.
function(vdbcarve_precompiled_header)
  file(WRITE ${PROJECT_BINARY_DIR}/modules/precompiled.cpp.new "// Compiled for its precompiled header.\n")
  file(COPY_FILE ${PROJECT_BINARY_DIR}/modules/precompiled.cpp.new ${PROJECT_BINARY_DIR}/modules/precompiled.cpp ONLY_IF_DIFFERENT)
  add_library(vdbcarve_precompiled OBJECT ${PROJECT_BINARY_DIR}/modules/precompiled.cpp)
  vdbcarve_like_all_modules(vdbcarve_precompiled)
  target_link_libraries(vdbcarve_precompiled PRIVATE OpenVDB::openvdb Eigen3::Eigen TBB::tbb Imath::Imath)
  target_precompile_headers(vdbcarve_precompiled PRIVATE <openvdb/openvdb.h> <Eigen/Dense> <string> <vector>)
endfunction()

function(vdbcarve_like_all_modules target)
  set_target_properties(${target} PROPERTIES POSITION_INDEPENDENT_CODE ${VDBCARVE_SHARED})
  target_link_libraries(${target} PRIVATE vdbcarve_flags vdbcarve_kernel)
endfunction()

function(vdbcarve_module name)
  cmake_parse_arguments(PARSE_ARGV 1 module "OPENVDB" "" "SOURCES;API;SHARED;PUBLIC;PRIVATE;LIBRARIES")
  if(module_UNPARSED_ARGUMENTS)
    message(FATAL_ERROR "module ${name}: ${module_UNPARSED_ARGUMENTS}?")
  endif()
  set(target vdbcarve_${name})
  set(source ${PROJECT_SOURCE_DIR}/src/${name})
  # For others: what it shares. For itself: its whole folder, under the same names.
  set(shared ${PROJECT_BINARY_DIR}/modules/${name}/shared)
  set(own ${PROJECT_BINARY_DIR}/modules/${name}/own)
  set(links)
  foreach(header ${module_API})
    list(APPEND links vdbcarve/${header})
    if(header STREQUAL "version.h")
      vdbcarve_link(${shared} vdbcarve/${header} ${PROJECT_BINARY_DIR}/include/vdbcarve/${header})
    else()
      vdbcarve_link(${shared} vdbcarve/${header} ${PROJECT_SOURCE_DIR}/include/vdbcarve/${header})
    endif()
  endforeach()
  foreach(header ${module_SHARED})
    list(APPEND links ${name}/${header})
    vdbcarve_link(${shared} ${name}/${header} ${source}/${header})
  endforeach()
  vdbcarve_unlink_others(${shared} "${links}")
  vdbcarve_link(${own} ${name} ${source})

  add_library(${target} OBJECT ${module_SOURCES})
  vdbcarve_like_all_modules(${target})
  target_include_directories(${target} BEFORE PRIVATE ${own})
  target_include_directories(${target} PUBLIC ${shared})
  list(TRANSFORM module_PUBLIC PREPEND vdbcarve_)
  list(TRANSFORM module_PRIVATE PREPEND vdbcarve_)
  target_link_libraries(${target} PUBLIC ${module_PUBLIC} Eigen3::Eigen PRIVATE ${module_PRIVATE} ${module_LIBRARIES} TBB::tbb)
  if(module_OPENVDB)
    target_link_libraries(${target} PRIVATE OpenVDB::openvdb Imath::Imath)
    target_precompile_headers(${target} REUSE_FROM vdbcarve_precompiled)
  endif()
  set_property(GLOBAL APPEND PROPERTY VDBCARVE_OBJECTS $<TARGET_OBJECTS:${target}>)
  set_property(GLOBAL APPEND PROPERTY VDBCARVE_LIBRARIES ${module_LIBRARIES})
endfunction()
