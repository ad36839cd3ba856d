include(CMakePackageConfigHelpers)
install(TARGETS vdbcarve vdbcarve_kernel EXPORT vdbcarveTargets
  ARCHIVE DESTINATION ${CMAKE_INSTALL_LIBDIR} LIBRARY DESTINATION ${CMAKE_INSTALL_LIBDIR})
install(TARGETS vdbcarve_cli RUNTIME DESTINATION ${CMAKE_INSTALL_BINDIR})
install(DIRECTORY include/vdbcarve DESTINATION ${CMAKE_INSTALL_INCLUDEDIR} PATTERN "*.in" EXCLUDE)
install(FILES ${PROJECT_BINARY_DIR}/include/vdbcarve/version.h DESTINATION ${CMAKE_INSTALL_INCLUDEDIR}/vdbcarve)
install(FILES data/cameras.schema.json DESTINATION ${CMAKE_INSTALL_DATADIR}/vdbcarve)
set(package_dir ${CMAKE_INSTALL_LIBDIR}/cmake/vdbcarve)
install(EXPORT vdbcarveTargets NAMESPACE vdbcarve:: DESTINATION ${package_dir})
configure_package_config_file(cmake/vdbcarveConfig.cmake.in ${PROJECT_BINARY_DIR}/vdbcarveConfig.cmake
  INSTALL_DESTINATION ${package_dir})
write_basic_package_version_file(${PROJECT_BINARY_DIR}/vdbcarveConfigVersion.cmake COMPATIBILITY SameMinorVersion)
install(FILES ${PROJECT_BINARY_DIR}/vdbcarveConfig.cmake ${PROJECT_BINARY_DIR}/vdbcarveConfigVersion.cmake
  cmake/Dependencies.cmake DESTINATION ${package_dir})
install(DIRECTORY ${PROJECT_BINARY_DIR}/pages/ DESTINATION ${CMAKE_INSTALL_MANDIR}/man1 FILES_MATCHING PATTERN "*.1")
install(DIRECTORY ${PROJECT_BINARY_DIR}/pages/ DESTINATION ${CMAKE_INSTALL_DOCDIR} FILES_MATCHING PATTERN "*.md")
